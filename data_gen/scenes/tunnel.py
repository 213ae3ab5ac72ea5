"""A tunnel of ten pipes, straight and bent: round walls, and light that has to go round corners, one after another.

`experiments/levels/tunnel.toml` is the same tunnel for modular transfer on pipes. It is open at both ends.
"""

from dataclasses import replace

from data_gen.tunnels import scene_of
from prt_bench.modular.tunnel import Piece, Tunnel
from prt_bench.scene import Scene

PIECES: tuple[Piece, ...] = (
    "straight", "left", "straight", "right", "right", "left", "straight", "left", "right", "straight",
)  # fmt: skip
WALLS = ((0.75, 0.7, 0.6), (0.7, 0.4, 0.3), (0.4, 0.55, 0.7))
"""Of the pieces, by turns."""
FLOOR = (0.5, 0.4, 0.3)


def build() -> Scene:
    """Pipes 2.4 m wide and 4 m, or a bend of 2 m, long, seen from near the beginning."""
    return replace(scene_of(Tunnel(PIECES), WALLS, FLOOR), name="tunnel")
