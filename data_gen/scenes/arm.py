"""A bending arm in a coloured room: a scene that moves, with two joints, a heavy hand and walls that tint it.

The arm is a closed tube around a bent centre line of constant length; time turns it about its foot and bends shoulder and
elbow. Faces and the lengths along the tube are the same at all times. Room and proportions are those of a Cornell box.
"""

import numpy as np
from jaxtyping import Float

from data_gen.geometry import Part, assemble, quad
from prt_bench.scene import Camera, Material, Scene

WHITE, RED, GREEN, ARM = range(4)
LENGTH, SHOULDER, ELBOW = 1.4, 0.3, 0.8
"""Of the centre line from foot to fingertip, and where along it the joints are, in metres."""
JOINT = 0.15
"""Half the length over which a joint bends, in metres."""
RADIUS, HAND, HAND_AT = 0.13, 0.28, 1.15
"""Of the arm and of the hand, and where along the centre line the hand's middle is, in metres."""
AROUND, ALONG = 32, 56
"""Vertices of a ring, and rings."""


def build(time: float = 0.0) -> Scene:
    """The room, x and z from −1 to 1, y from 0 to 2; the arm's foot is in the middle. The motion repeats after time 1."""
    materials = (
        Material("white", (0.725, 0.71, 0.68)),
        Material("red", (0.63, 0.065, 0.05)),
        Material("green", (0.14, 0.45, 0.091)),
        Material("arm", (0.75, 0.6, 0.2)),
    )
    parts = [
        quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], WHITE),  # floor
        quad([(-1, 2, -1), (1, 2, -1), (1, 2, 1), (-1, 2, 1)], WHITE),  # ceiling
        quad([(-1, 0, -1), (1, 0, -1), (1, 2, -1), (-1, 2, -1)], WHITE),  # back
        quad([(-1, 0, 1), (-1, 0, -1), (-1, 2, -1), (-1, 2, 1)], RED),  # left
        quad([(1, 0, -1), (1, 0, 1), (1, 2, 1), (1, 2, -1)], GREEN),  # right
        _arm(*_angles(time)),
    ]
    return Scene("arm", assemble(parts), materials, Camera((0.0, 1.0, 3.9), (0.0, 1.0, 0.0), fov_y=39.3))


def _angles(time: float) -> tuple[float, float, float]:
    """Turn about the foot and bends of shoulder and elbow, in radians."""
    phase = 2.0 * np.pi * time
    turn = phase + 0.3 * np.sin(2.0 * phase)
    return turn, np.radians(25.0 + 15.0 * np.cos(phase)), np.radians(55.0 - 45.0 * np.sin(2.0 * phase))


def _arm(turn: float, shoulder: float, elbow: float) -> Part:
    """Rings perpendicular to the centre line, and a vertex at either end."""
    along = np.linspace(0.0, LENGTH, ALONG)
    centre, lean = _centre_line(along, shoulder, elbow)
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    across = np.stack([np.cos(lean), -np.sin(lean), np.zeros_like(lean)], axis=1)  # in the plane of the bend
    side = np.array([0.0, 0.0, 1.0])
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * side
    rings = centre[:, None] + _radius(along)[:, None, None] * ring
    vertices = np.concatenate([rings.reshape(-1, 3), centre[[0, -1]]])
    turned = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    return Part(vertices @ turned.T, _faces(), ARM)


def _centre_line(
    along: Float[np.ndarray, " n"], shoulder: float, elbow: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Points of the centre line in the plane z = 0, and its angle from the vertical there."""

    def lean(at: np.ndarray) -> np.ndarray:
        share = np.clip((at[:, None] - (SHOULDER, ELBOW)) / (2.0 * JOINT) + 0.5, 0.0, 1.0)
        return (share * share * (3.0 - 2.0 * share)) @ (shoulder, elbow)

    # The integral of the direction, by the midpoint rule on each of many short steps.
    steps = np.linspace(0.0, LENGTH, 16 * (ALONG - 1) + 1)
    middle = lean(0.5 * (steps[1:] + steps[:-1]))
    moves = np.diff(steps)[:, None] * np.stack([np.sin(middle), np.cos(middle), np.zeros_like(middle)], axis=1)
    line = np.concatenate([np.zeros((1, 3)), np.cumsum(moves, axis=0)])
    return line[::16], lean(along)


def _radius(along: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """A tube that swells to an ellipsoid, the hand, at its far end."""
    reach = LENGTH - HAND_AT
    ball = HAND * np.sqrt(np.maximum(1.0 - ((along - HAND_AT) / (1.02 * reach)) ** 2, 0.0))
    return np.where(along > HAND_AT, ball, np.maximum(RADIUS, ball))


def _faces() -> np.ndarray:
    row, column = np.meshgrid(np.arange(ALONG - 1), np.arange(AROUND), indexing="ij")
    a, b = row * AROUND + column, row * AROUND + (column + 1) % AROUND
    lower, upper = np.stack([a, a + AROUND, b], -1), np.stack([b, a + AROUND, b + AROUND], -1)
    foot, tip = ALONG * AROUND, ALONG * AROUND + 1
    first, last = np.arange(AROUND), (ALONG - 1) * AROUND + np.arange(AROUND)
    caps = [np.stack([np.full(AROUND, foot), first, np.roll(first, -1)], -1),
            np.stack([np.full(AROUND, tip), np.roll(last, -1), last], -1)]  # fmt: skip
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3), *caps])
