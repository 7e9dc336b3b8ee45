"""What can go wrong, by the name under which the guard reports it, and what the operator does about it."""

import enum


class Fault(enum.Enum):
    """A latched fault; the value is the sentence behind its name."""

    E_STOP = "emergency stop: make the car safe, remove a stop file, then arm anew"
    POLICY_GONE = "the policy's process ended: what it said stands beside this"
    POLICY_SILENT = "no command for 120 ms: the computer is overloaded or the policy hangs"
    BAD_COMMAND = "a command that no sound policy sends: look for it in the log before driving again"
    PICTURES_OLD = (
        "no picture, or only equal ones, for 250 ms: look at the camera, its cable, its rate and the computer's load"
    )
    PICTURES_FROZEN = "ten pictures in a row are the same to the bit: the camera hangs, restart it"
    ESC_SILENT = "the motor controller has not answered for 500 ms: look at its cable and its power"
    ESC_FAULT = "the motor controller reports a fault: read its code in VESC Tool"
    ESC_HOT = "the motor controller is too hot: let it cool down"
    KILL_SWITCH = "the motor controller's kill switch is on: release it at the car"
    BATTERY = "the battery's voltage is out of range: charge it, or mend the car's file"
    SPEED_MISMATCH = "the wheels do not turn as they were told: look for a stall, slip or wrong speed_to_erpm_gain"
    ROLLING = "the wheels turn though nothing was asked of them: hold the car"
    LINK_LOST = "the serial port is gone: plug it in again, then check, yes and arm"
    LINK_BLOCKED = "the serial port takes no more bytes: look at the cable and restart the motor controller"
    GUARD_LATE = "the guard slept for over 100 ms: the computer is overloaded"
    WRONG_CALIBRATION = "the wheels did not turn left, then right: mend servo_gain in the car's file"
