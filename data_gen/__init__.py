"""Everything that makes data: scenes, atlases, sample points, lightings, ray tracing and the bake.

May import the core of `prt_bench` (scene, lights, points, transport, dataset, errors); the core never imports this package.
"""
