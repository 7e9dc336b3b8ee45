"""The guard: the process that owns the car's serial port. Standard library and pyserial only: read it in one go.

It sends motion only as the consequence of a fresh, valid command, enforces limits and rates, and brakes when in doubt.
Times are seconds of the monotonic clock, which all processes of a machine share; angles radians, positive to the left;
speeds m/s; currents amperes. From bytes to bytes: `messages` -> `guard` (`states`, `health`, `set_point`) -> `vesc`.
"""
