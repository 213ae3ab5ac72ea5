"""A window on the runtime, where there is a display: orbit the camera, step through lightings, switch light on and off.

Frames are drawn off screen as everywhere else and shown by Tk, so the viewer runs on the same code that is timed.
"""

import tkinter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageTk

from prt_bench.errors import RuntimeUnavailable
from prt_bench.images import exposure_for
from prt_bench.lights import Lighting, turned
from prt_bench.runtime.indirect import Indirect
from prt_bench.runtime.runtime import Runtime
from prt_bench.scene import Camera

_STEEPEST = np.radians(89.0)
_TURN = np.radians(5.0)


@dataclass(frozen=True)
class Orbit:
    """A camera on a sphere about its target, y up: `yaw` and `pitch` in radians, `distance` in metres."""

    target: tuple[float, float, float]
    yaw: float
    pitch: float
    distance: float
    fov_y: float

    @classmethod
    def of(cls, camera: Camera) -> "Orbit":
        """The orbit that a camera is on."""
        x, y, z = np.subtract(camera.position, camera.target)
        distance = float(np.linalg.norm((x, y, z)))
        return cls(camera.target, float(np.arctan2(x, z)), float(np.arcsin(y / distance)), distance, camera.fov_y)

    def turned(self, yaw: float, pitch: float) -> "Orbit":
        """Turned by two angles, stopping short of the poles."""
        return replace(self, yaw=self.yaw + yaw, pitch=float(np.clip(self.pitch + pitch, -_STEEPEST, _STEEPEST)))

    @property
    def camera(self) -> Camera:
        """The camera there."""
        level = np.cos(self.pitch)
        away = np.array([level * np.sin(self.yaw), np.sin(self.pitch), level * np.cos(self.yaw)])
        x, y, z = self.target + self.distance * away
        return Camera((float(x), float(y), float(z)), self.target, fov_y=self.fov_y)


def view(runtime: Runtime, lightings: Sequence[Lighting], indirect: Indirect, camera: Camera) -> None:
    """Open a window and return when it is closed. Raises `RuntimeUnavailable` where there is no display.

    Drag to orbit, wheel to zoom, space for the next lighting, [ and ] to turn distant light about the vertical, i and d to
    switch indirect and direct light, + and − for exposure, q to close.
    """
    try:
        window = tkinter.Tk()
    except tkinter.TclError as error:
        raise RuntimeUnavailable(f"the viewer needs a display ({error}); frames can be drawn without one") from error
    _Viewer(window, runtime, lightings, indirect, camera)
    window.mainloop()


class _Viewer:
    """What the window shows, and what its events change."""

    def __init__(
        self,
        window: tkinter.Tk,
        runtime: Runtime,
        lightings: Sequence[Lighting],
        indirect: Indirect,
        camera: Camera,
    ) -> None:
        self._runtime, self._indirect = runtime, indirect
        self._lightings, self._lights = lightings, [runtime.light(lighting) for lighting in lightings]
        self._angle = 0.0
        self._orbit = Orbit.of(camera)
        self._chosen, self._exposure = 0, exposure_for(runtime.frame(self._lights[0], indirect))
        self._shown = {"i": True, "d": True}
        self._grip = (0, 0)
        self._window = window
        self._label = tkinter.Label(window, borderwidth=0)
        self._label.pack()
        window.bind("<ButtonPress-1>", lambda event: self._hold(event.x, event.y))
        window.bind("<B1-Motion>", lambda event: self._drag(event.x, event.y))
        for event, factor in (("<Button-4>", 0.9), ("<Button-5>", 1 / 0.9)):
            window.bind(event, lambda _, factor=factor: self._zoom(factor))
        window.bind("<MouseWheel>", lambda event: self._zoom(0.9 if event.delta > 0 else 1 / 0.9))
        window.bind("<space>", lambda _: self._next())
        for key, angle in (("[", -_TURN), ("]", _TURN)):
            window.bind(key, lambda _, angle=angle: self._turn(angle))
        for key in self._shown:
            window.bind(key, lambda _, key=key: self._switch(key))
        for key, stops in (("+", 0.25), ("<minus>", -0.25)):
            window.bind(key, lambda _, stops=stops: self._expose(stops))
        window.bind("q", lambda _: window.destroy())
        self._draw()

    def _draw(self) -> None:
        self._runtime.look_from(self._orbit.camera)
        indirect = self._indirect if self._shown["i"] else None
        direct = self._shown["d"] or indirect is None
        picture = self._runtime.picture(self._lights[self._chosen], indirect, direct, self._exposure)
        self._photo = ImageTk.PhotoImage(Image.fromarray(picture), master=self._window)  # Tk keeps no reference
        self._label.configure(image=self._photo)
        self._window.title(f"{self._runtime.scene.name}, lighting {self._chosen} · {self._runtime.device}")

    def _hold(self, x: int, y: int) -> None:
        self._grip = (x, y)

    def _drag(self, x: int, y: int) -> None:
        self._orbit = self._orbit.turned(0.01 * (self._grip[0] - x), 0.01 * (y - self._grip[1]))
        self._grip = (x, y)
        self._draw()

    def _zoom(self, factor: float) -> None:
        self._orbit = replace(self._orbit, distance=self._orbit.distance * factor)
        self._draw()

    def _next(self) -> None:
        self._chosen = (self._chosen + 1) % len(self._lights)
        self._turn(0.0)

    def _turn(self, angle: float) -> None:
        self._angle += angle
        self._lights[self._chosen] = self._runtime.light(turned(self._lightings[self._chosen], self._angle))
        self._draw()

    def _switch(self, key: str) -> None:
        self._shown[key] = not self._shown[key]
        self._draw()

    def _expose(self, stops: float) -> None:
        self._exposure += stops
        self._draw()
