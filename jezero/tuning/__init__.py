"""Tuning of the estimator: its innovations in recorded flights, and the noise settings that fit them."""
