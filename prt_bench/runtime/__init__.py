"""The OpenGL runtime: one renderer that runs any asset, measures like the bake, and times what it draws."""

from prt_bench.runtime.context import headless, is_software, renderer
from prt_bench.runtime.indirect import Indirect, LoadedAsset, PlainLightmap
from prt_bench.runtime.runtime import Runtime
from prt_bench.runtime.timing import time_assets

__all__ = ["Indirect", "LoadedAsset", "PlainLightmap", "Runtime", "headless", "is_software", "renderer", "time_assets"]
