"""The ground station: pages in a browser in which a vehicle is watched and flown."""
