"""The errors a user can cause. Each carries one sentence: what is wrong, where, and what to do.

The command line prints that sentence and exits with status 2. Anything else that escapes is a bug in prt-bench
and keeps its traceback.
"""


class PrtBenchError(Exception):
    """Base of every error that a user of prt-bench can mend."""


class SceneError(PrtBenchError):
    """A mesh or scene description that cannot be used as it is."""


class LightError(PrtBenchError):
    """A light or lighting that is not physical or does not fit the scene."""


class SpecError(PrtBenchError):
    """A run specification or a setting with an unknown or impossible value."""


class DatasetError(PrtBenchError):
    """A dataset that is missing, damaged, or not what was asked for."""


class FitError(PrtBenchError):
    """A fit that the data cannot support."""


class AssetError(PrtBenchError):
    """A runtime asset that is damaged, of another version, or not renderable."""


class RuntimeUnavailable(PrtBenchError):
    """No OpenGL context could be made on this machine."""
