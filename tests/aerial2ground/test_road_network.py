"""The road network: points on it, distances to it, and what is refused."""

import contextlib
import json
import math
import os
from pathlib import Path

import pytest
import torch

from aerial2ground.road_network import (
    EARTH_RADIUS,
    distance_to_line,
    network_from_geojson,
    read_road_file,
    read_road_network,
)
from hashnerf.errors import UserError

HERE = torch.zeros(3, dtype=torch.float64)
ENTRY = {"lines": [[[0, 0], [4, 0]], [[4, 0], [4, 2]]], "width": 1.0, "height": 0.5, "colour": [51, 102, 255]}


def network(**changes):
    return read_road_network(ENTRY | changes, HERE, "town/transforms.json")


def test_a_network_as_told():
    roads = network()
    assert roads.length == 6.0 and roads.width == 1.0 and roads.height == 0.5
    assert roads.colours.tolist() == [pytest.approx([0.2, 0.4, 1.0])] * 2
    assert network(colour=[[0, 0, 0], [255, 255, 255]]).colours.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_loading_moves_it_with_the_poses():
    moved = read_road_network(ENTRY, torch.tensor([10.0, 20.0, 0.5], dtype=torch.float64), "x")
    assert moved.lines[0].tolist() == [[-10, -20], [-6, -20]] and moved.height == 0.0


HILLY = [[[0, 0, 1.0], [4, 0, 3.0]], [[4, 0, 3.0], [4, 2, 2.0]]]


def hilly(**changes):
    entry = {key: value for key, value in ENTRY.items() if key != "height"} | {"lines": HILLY}
    return read_road_network(entry | changes, HERE, "town/transforms.json")


def test_heights_of_a_road_that_rises():
    roads = hilly()
    assert roads.length == 6.0 and roads.height == 2.0, "lengths are those of the map; the median of 1, 2, 3, 3"
    # a quarter of the first line: 1 + 2 / 4; beside its middle: 2; past its end: 3; half of the second: 2.5
    places = torch.tensor([[1.0, 0.0], [2.0, -0.5], [5.0, -1.0], [4.5, 1.0]])
    assert roads.heights_at(places).tolist() == [1.5, 2.0, 3.0, 2.5]
    points, _ = roads.sample(500, torch.Generator().manual_seed(0))
    first = points[points[:, 0] < 3.4]
    assert torch.allclose(first[:, 2], 1 + first[:, 0] / 2, atol=1e-5)
    level, _ = network().sample(500, torch.Generator().manual_seed(0))
    assert torch.equal(level[:, :2], points[:, :2]), "heights change no place"


def test_level_roads_have_one_height_everywhere():
    assert network().heights is None
    assert network().heights_at(torch.tensor([[1.0, 0.0], [90.0, 7.0]])).tolist() == [0.5, 0.5]


def test_loading_moves_heights_with_the_poses():
    entry = {"lines": HILLY, "width": 1.0, "colour": [9, 9, 9]}
    moved = read_road_network(entry, torch.tensor([10.0, 20.0, 0.5], dtype=torch.float64), "x")
    assert [height.tolist() for height in moved.heights] == [[0.5, 2.5], [2.5, 1.5]] and moved.height == 1.5
    assert moved.lines[0].tolist() == [[-10, -20], [-6, -20]]


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"height": 1.0}, "tells some heights twice or not at all"),
        ({"lines": [HILLY[0], [[4, 0], [4, 2]]]}, "tells some heights twice or not at all"),
        ({"lines": [[[0, 0, 1], [4, 0]]]}, "or all [x, y, z], in metres"),
        ({"lines": [[[0, 0, 1], [0, 0, 3]]]}, "lines[0] has no length"),
    ],
)
def test_bad_heights_are_named(changes, sentence):
    with pytest.raises(UserError) as caught:
        hilly(**changes)
    assert sentence in str(caught.value)


def test_a_file_of_its_own(tmp_path):
    file = tmp_path / "roads.json"
    file.write_text(json.dumps(ENTRY))
    assert read_road_file(file) == ENTRY
    file.write_text("{")
    with pytest.raises(UserError, match="cannot be read as a road network in JSON"):
        read_road_file(file)
    with pytest.raises(UserError, match="nowhere"):
        read_road_file(tmp_path / "nowhere.json")


HOSTILE = {"1e5 levels": "[" * 100_000, "twice a key": '{"width": 1, "width": 2}', "NaN": '{"width": NaN}'}


def test_k34_hostile_files_of_roads_are_named(tmp_path, numeric_row):
    file, wrong = tmp_path / "roads.json", []
    os.mkfifo(tmp_path / "pipe.json")  # opening it would wait for ever
    for read in (read_road_file, lambda path: network_from_geojson(path, 5.0, [90, 90, 90])):
        for case, text in HOSTILE.items():
            file.write_text(text)
            with contextlib.suppress(UserError):
                wrong.append((case, read(file)))
        with contextlib.suppress(UserError):
            wrong.append(("a pipe", read(tmp_path / "pipe.json")))
    print(wrong)
    numeric_row("K34", f"roads in JSON and GeoJSON: {', '.join(HOSTILE)}, a pipe: read", len(wrong))


def test_the_roads_that_come_with_the_project():
    file = Path(__file__).resolve().parents[2] / "configs" / "aerial2ground" / "caliterra_roads.json"
    roads = read_road_network(read_road_file(file), HERE, str(file))
    assert 200 < roads.length < 350 and all(-1 < float(height.min()) < 1 for height in roads.heights)


def test_points_lie_on_roads_evenly_and_know_their_colour():
    roads = network(colour=[[0, 0, 0], [255, 255, 255]])
    points, colour = roads.sample(6000, torch.Generator().manual_seed(0))
    assert (roads.distance(points[:, :2]) <= 0.5 + 1e-6).all() and (points[:, 2] == 0.5).all()
    assert float(colour[:, 0].mean()) == pytest.approx(2 / 6, abs=0.03), "the second road is 2 of 6 metres"
    assert float(points[colour[:, 0] == 0, 0].mean()) == pytest.approx(2.0, abs=0.1)
    again, _ = roads.sample(6000, torch.Generator().manual_seed(0))
    assert torch.equal(points, again)


def test_distances_by_hand():
    points = torch.tensor([[1.0, 3.0], [-3.0, 4.0], [2.0, 0.0]])
    assert distance_to_line(torch.tensor([[0.0, 0.0], [4.0, 0.0]]), points).tolist() == [3.0, 5.0, 0.0]


BAD_NETWORKS = [
    ({"lines": []}, "road_network.lines is empty"),
    ({"lines": "abc"}, "road_network.lines is empty"),
    ({"lines": [[[0, 0]]]}, "lines[0] must be two or more points"),
    ({"lines": [[[0, 0], [1, math.nan]]]}, "lines[0] must be two or more points"),
    ({"lines": [[[0, 0], [0, 0]]]}, "lines[0] has no length"),
    ({"lines": [[[0, 0], [4, 0]], [[0, 9], [4, 9]]]}, "lines[1] meets no other road"),
    ({"width": 0}, "road_network.width is 0"),
    ({"width": -1.0}, "road_network.width is -1.0"),
    ({"width": math.inf}, "road_network.width is inf"),
    ({"height": "low"}, "road_network.height is low"),
    ({"height": math.nan}, "road_network.height is nan"),
    ({"colour": [0, 0]}, "road_network.colour must be"),
    ({"colour": [0, 0, 300]}, "road_network.colour must be"),
    ({"color": [0, 0, 0]}, "unknown key 'color'"),
]


def test_k47_a_bad_network_is_named(numeric_row):
    wrong = []
    for changes, sentence in BAD_NETWORKS:
        try:
            network(**changes)
            wrong.append(changes)
        except UserError as error:
            told = sentence in str(error) and str(error).startswith("town/transforms.json: ")
            wrong += [] if told else [(changes, str(error))]
    print(wrong)
    numeric_row(
        "K47", f"{len(BAD_NETWORKS)} networks: empty, without length, width <= 0, ...: read, or not named", len(wrong)
    )


def test_no_network_at_all():
    with pytest.raises(UserError, match="has no road_network; draw"):
        read_road_network(None, HERE, "x")


def test_geojson_becomes_metres(tmp_path):
    file = tmp_path / "roads.geojson"
    line = {"type": "LineString", "coordinates": [[10.0, 60.0], [10.002, 60.0], [10.002, 60.001]]}
    feature = {"type": "Feature", "geometry": line, "properties": {}}
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    entry, (east, north) = network_from_geojson(file, 5.0, [90, 90, 90])
    roads = read_road_network(entry, HERE, "x")
    degree = math.radians(1) * EARTH_RADIUS
    expected = 0.002 * degree * math.cos(math.radians(north)) + 0.001 * degree
    assert roads.length == pytest.approx(expected, rel=1e-4) and east == pytest.approx(10.0013333)
    assert entry["lines"][0][1][0] > entry["lines"][0][0][0], "east is +x"


def test_geojson_from_a_given_origin(tmp_path):
    file = tmp_path / "roads.geojson"
    file.write_text(json.dumps({"type": "LineString", "coordinates": [[10.0, 60.0], [10.0, 60.001]]}))
    entry, origin = network_from_geojson(file, 5.0, [90, 90, 90], (10.0, 59.999))
    metre = 0.001 * math.radians(1) * EARTH_RADIUS
    assert origin == (10.0, 59.999)
    assert entry["lines"][0] == [[0.0, pytest.approx(metre, rel=1e-6)], [0.0, pytest.approx(2 * metre, rel=1e-6)]]


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("not json", "cannot be read as GeoJSON"),
        ('{"type": "Point", "coordinates": [1, 2]}', "holds no LineString"),
        ('{"type": "LineString", "coordinates": [[500000, 10], [500001, 10]]}', "longitude and latitude in degrees"),
    ],
)
def test_a_bad_geojson_is_named(tmp_path, text, sentence):
    file = tmp_path / "roads.geojson"
    file.write_text(text)
    with pytest.raises(UserError, match=sentence):
        network_from_geojson(file, 5.0, [90, 90, 90])
