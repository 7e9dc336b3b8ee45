import numpy as np

from worlds.meshes import Material, block
from worlds.raycast import Caster

WHITE = Material((1.0, 1.0, 1.0))
DOWN = np.array([[0, 0, -1]], np.float32)


def test_first_hit_with_distance_face_and_object():
    caster = Caster([(3, block((-1, -1, 0), (1, 1, 1), WHITE)), (7, block((4, -1, 0), (6, 1, 2), WHITE))])
    origins = np.array([[0.2, 0.3, 5], [5.2, 0.3, 5], [20, 0, 5]], np.float32)
    distance, face = caster.cast(origins, np.repeat(DOWN, 3, 0))
    np.testing.assert_allclose(distance, [4, 3, np.inf])
    assert caster.object_id[face[:2]].tolist() == [3, 7]
    np.testing.assert_array_equal(caster.normal[face[:2]], [[0, 0, 1], [0, 0, 1]])
    assert face[2] == -1


def test_occluded_along_one_direction():
    caster = Caster([(1, block((-1, -1, 2), (1, 1, 3), WHITE))])
    origins = np.array([[0.1, 0, 0], [5, 0, 0], [0.1, 0, 4]], np.float32)
    assert caster.occluded(origins, np.array([0, 0, 1], np.float32)).tolist() == [True, False, False]


def test_nothing_to_hit_and_no_rays():
    empty, full = Caster([]), Caster([(1, block((-1, -1, 0), (1, 1, 1), WHITE))])
    origin = np.array([[0, 0, 5]], np.float32)
    assert empty.cast(origin, DOWN)[0].tolist() == [np.inf]
    assert empty.occluded(origin, DOWN[0]).tolist() == [False]
    assert full.cast(origin[:0], DOWN[:0])[1].shape == (0,)
    assert full.occluded(origin[:0], DOWN[0]).shape == (0,)
