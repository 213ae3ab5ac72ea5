"""Geometry without mesh or texture coordinates: signed distances that JAX differentiates and shaders evaluate.

`expression` says what a distance is, `shapes`, `grid` and `operations` hold them, `scene` joins them with materials, and
`tracing` follows rays. Sampling, visibility tables and built-in scenes are in `data_gen`, drawing in `prt_bench.runtime`.
"""
