"""The one place that makes an OpenGL context: headless through EGL. What is drawn with it lives in the passes."""

from functools import lru_cache

import moderngl

from prt_bench.errors import RuntimeUnavailable

REQUIRED_VERSION = 430
"""OpenGL 4.3: compute shaders and shader storage buffers."""
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "software", "swiftshader", "lavapipe")


@lru_cache(maxsize=1)
def headless() -> moderngl.Context:
    """The process's headless context. Raises `RuntimeUnavailable` when the machine has no usable OpenGL."""
    try:
        context = moderngl.create_context(
            require=REQUIRED_VERSION,
            standalone=True,
            backend="egl",  # pyright: ignore[reportArgumentType]
        )
    except Exception as error:  # glcontext raises bare exceptions for missing libraries, displays and versions alike
        raise RuntimeUnavailable(
            f"no OpenGL 4.3 context could be made ({error}); on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri"
        ) from error
    context.gc_mode = "auto"
    return context


def renderer(context: moderngl.Context) -> str:
    """What draws, as the driver names it, e.g. "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    return str(context.info["GL_RENDERER"])


def is_software(name: str) -> bool:
    """Whether a renderer draws on the CPU: then its timer queries mean nothing and wall clock counts."""
    return any(marker in name.lower() for marker in _SOFTWARE)


def check(context: moderngl.Context, what: str) -> None:
    """Raise `RuntimeError` if OpenGL reported an error; `what` says during which work."""
    error = context.error
    if error != "GL_NO_ERROR":
        raise RuntimeError(f"OpenGL reported {error} during {what}")
