#!/bin/sh
# Starts PX4 in its own simulator as it is started in jezero's, and MAVLink at a serial line, as a flight controller has
# it at TELEM2, and PX4's gimbal manager with servos.
. "$PX4_START"
if [ -n "$PX4_GIMBAL" ]; then
	param set MNT_MODE_IN 4
	param set MNT_MODE_OUT 0
	gimbal start
fi
if [ -n "$PX4_LINE" ]; then
	mavlink start -d "$PX4_LINE" -b "$PX4_BAUD" -m onboard -x
fi
