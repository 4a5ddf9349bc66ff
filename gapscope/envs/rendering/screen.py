"""The screen of an environment: collects what happens, and shows it or hands it out."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.kinematics import Kinematics
from gapscope.arm.nearest_name import check_known
from gapscope.envs.rendering.picture import Picture
from gapscope.envs.rendering.scene import Scene
from gapscope.envs.rendering.viewer import Viewer, open_viewer

MODES = ("human", "rgb_array")


class Screen:
    """Pictures of one environment's episodes.

    Args:
        kinematics: of the arm.
        mode: ``human`` or ``rgb_array``.
        period: time between actions [s].

    Raises:
        InputError: unknown mode.
    """

    def __init__(self, kinematics: Kinematics, mode: str, period: float) -> None:
        self._mode, self._period = (
            check_known("render mode", mode, MODES, where="render_mode"),
            period,
        )
        self._picture = Picture(kinematics)
        self._scene: Scene | None = None
        self._viewer: Viewer | None = None

    def begin(self, title: str, q_ref: np.ndarray) -> None:
        """Begin an episode with its reference at every action [rad], shape (K + 1, n)."""
        self._scene = Scene(title, self._period, q_ref)
        self._picture.begin(self._scene)

    def add(
        self, q: np.ndarray, error: np.ndarray, load: np.ndarray, ending: str = ""
    ) -> None:
        """Add what an action came to, and show it in mode ``human``.

        Args:
            q: true positions [rad], shape (n,).
            error: reference minus encoders [rad], shape (n,).
            load: commanded over rated torque [1], shape (n,).
            ending: why the episode ends early, or nothing.
        """
        scene = self._scene
        if scene is None:
            return
        scene.q.append(np.array(q))
        scene.error.append(np.array(error))
        scene.load, scene.ending = np.array(load), ending
        if self._mode == "human":
            if self._viewer is None:
                self._viewer = open_viewer("Gapscope", self._period)
            rms = 1e3 * float(np.sqrt(np.mean(np.square(error))))
            caption = f"{scene.title}: t = {scene.period * scene.now:.2f} s, error {rms:.2f} mrad RMS. {ending}"
            self._viewer.show(self._picture.draw(scene), caption)

    def picture(self) -> np.ndarray | None:
        """The picture now, uint8, shape (height, width, 3), in mode ``rgb_array``; nothing before the first episode."""
        if self._mode != "rgb_array" or self._scene is None:
            return None
        return self._picture.draw(self._scene)

    def close(self) -> None:
        """Close the window, if there is one; a second call does nothing."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
