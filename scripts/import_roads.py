"""Turn the lines of a GeoJSON file (of a map editor, or OpenStreetMap) into a road network in metres.

python scripts/import_roads.py --geojson roads.geojson --width 4 --colour '[120, 117, 108]' --out roads.json
"""

import json
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.road_network import network_from_geojson
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.transforms_json import write_atomically


@dataclass(frozen=True)
class ImportConfig:
    """What to read and what no map says."""

    geojson: str
    """File with LineStrings in longitude and latitude (WGS 84)."""
    out: str
    """JSON file to write, for the config key `road_network`."""
    width: float
    """Width of the roads, metres."""
    colour: tuple[int, int, int]
    """Colour of the roads, 0 to 255."""
    origin: tuple[float, ...] = ()
    """Longitude and latitude of the origin of the camera poses; empty: the middle of the lines, which is printed."""

    def __post_init__(self):
        if len(self.origin) not in (0, 2):
            raise UserError(f"origin is {list(self.origin)}; give longitude and latitude in degrees")
        if not self.width > 0:
            raise UserError(f"width is {self.width}; give a positive number of metres")


def main() -> None:
    """Convert and say where the origin lies."""
    config = parse_config(ImportConfig, description="Turn GeoJSON lines into a road network.")
    origin = (config.origin[0], config.origin[1]) if config.origin else None
    network, (east, north) = network_from_geojson(Path(config.geojson), config.width, config.colour, origin)
    write_atomically(Path(config.out), json.dumps(network).encode())
    print(f"{config.out}: {len(network['lines'])} lines, metres from longitude {east:.7f}, latitude {north:.7f}")


if __name__ == "__main__":
    run_main(main)
