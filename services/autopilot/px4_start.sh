#!/bin/sh
# Starts PX4 as its own script does, and gives its simulated battery the endurance of the vehicle: PX4's own is half
# empty after 30 s of flight, and empties no further.
. etc/init.d-posix/rcS
param set SIM_BAT_DRAIN "$PX4_BATTERY_S"
param set SIM_BAT_MIN_PCT 0
