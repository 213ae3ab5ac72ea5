"""Transfer on a dictionary of shapes that are joined to levels, with no precomputation per scene (Loos et al. 2011).

`cube` is the one shape and its one-bounce operator, `modes` the reduced operators of a cube with missing faces, `lightfield`
what passes through a missing face, `dictionary` all of these as one file, `level` blocks on a grid and their light. `block` is
one cube for a scene of any geometry.
"""
