"""Transfer on a dictionary of shapes that are joined to levels, with no precomputation per scene (Loos et al. 2011).

`cube` is one shape and its one-bounce operator, `rotations` its 24 poses, `modes` the reduced operators of a cube with missing
faces, `lightfield` what passes through a missing face, `dictionary` all of these as one file, `passages` how light goes from
face to face by them, `level` blocks on a grid, in one layer or several, and their light. `secondary` and `level_secondary` have
what normal maps and bodies in the air need besides. `block` is one cube for a scene of any geometry. `pipe`, `pipe_light`,
`pipe_dictionary` and `tunnel` are the same for round pipes, straight and bent, with the light of `level`. `carried` sends light
from shape to shape, whatever the shapes are.
"""
