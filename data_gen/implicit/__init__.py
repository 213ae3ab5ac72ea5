"""Making data of scenes without meshes: `sampling` draws surface points, `bake` traces what they receive, `mesh` turns a
triangle mesh into a distance, `scenes` builds what is shipped, `reference` follows paths that share nothing with the bake.
"""
