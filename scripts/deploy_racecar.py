"""Drive a racecar by a trained policy: camera -> network -> guard -> VESC motor controller.

python scripts/deploy_racecar.py --port                                       lists the serial ports
python scripts/deploy_racecar.py --policy policy.onnx --camera 0 --dry-run    opens no port
python scripts/deploy_racecar.py --policy policy.onnx --camera 0 --port /dev/ttyACM0 --car configs/cars/f1tenth.yaml

Then say `check` (the wheels turn left and right), `yes`, `arm`, and hold the key g; let go to stop, space bar in an
emergency. docs/deploy.md has wiring, settings and the list for the first run.
"""

import sys

from aerial2ground.bridge.launch import LIST, DeployConfig, fill_standard_streams, launch, normal_arguments
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """List the ports, or start the bridge."""
    fill_standard_streams()
    arguments = normal_arguments(sys.argv[1:])
    if arguments == ["--port", LIST]:
        from aerial2ground.guard.serial_link import describe_candidates

        print("\n".join(describe_candidates()) or "No serial ports here: plug the motor controller in.")
        return
    launch(parse_config(DeployConfig, arguments, description="Drive a racecar by a trained policy."))


if __name__ == "__main__":
    run_main(main)
