"""The rotations of the cube as a group, on its faces, on its samples, and on light."""

import numpy as np

from prt_bench.modular.cube import inward, one_bounce, sample_points
from prt_bench.modular.modes import direct_light
from prt_bench.modular.rotations import FACE, INVERSE, PRODUCT, ROTATIONS, turns

SIDE = 6


def test_there_are_twenty_four_and_they_are_a_group():
    assert len({tuple(each.ravel()) for each in ROTATIONS}) == 24
    np.testing.assert_array_equal(np.round(np.linalg.det(ROTATIONS)), 1)
    np.testing.assert_array_equal(ROTATIONS @ np.swapaxes(ROTATIONS, 1, 2), np.broadcast_to(np.eye(3), (24, 3, 3)))
    for a in range(24):
        assert PRODUCT[a, INVERSE[a]] == PRODUCT[INVERSE[a], a] == 0
        for b in range(24):
            np.testing.assert_array_equal(ROTATIONS[PRODUCT[a, b]], ROTATIONS[a] @ ROTATIONS[b])


def test_faces_go_where_their_normals_do():
    normal = inward(np.arange(6))
    for rotation, matrix in enumerate(ROTATIONS):
        np.testing.assert_allclose(inward(FACE[rotation]), normal @ matrix.T)
    np.testing.assert_array_equal(FACE[:6, 0], np.arange(6))  # the frames of the six directions
    for rotation in (0, 5, 1, 4):
        np.testing.assert_array_equal(ROTATIONS[rotation][1], (0, 1, 0))  # keep up as it is
    assert all(FACE[6 * rolls, 0] == 0 for rolls in range(4))


def test_light_is_taken_along():
    position, normal = sample_points(SIDE)
    turned = turns(SIDE)
    for vectors in (position, normal):
        for rotation, matrix in enumerate(ROTATIONS):
            np.testing.assert_allclose((vectors @ matrix.T)[turned[rotation]], vectors, atol=1e-15)
    light = direct_light(SIDE, (), 5)
    once = one_bounce(SIDE) @ light
    for order in turned:
        np.testing.assert_allclose(one_bounce(SIDE) @ light[order], once[order], rtol=0.02)
