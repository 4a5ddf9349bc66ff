"""Rendering: what the picture shows, how fast, and where it goes without a display."""

import io
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from rich.console import Console

from gapscope.effects.applied import AppliedEffect
from gapscope.envs.environment import ArmTracking
from gapscope.envs.rendering import (
    ARM,
    GHOST,
    HEIGHT,
    WIDTH,
    TerminalViewer,
    open_viewer,
)

PAYLOAD = AppliedEffect("payload", (), {"mass": 6.0, "com": [0.0, 0.0, 0.1]})


def _picture(env: ArmTracking, steps: int = 40) -> np.ndarray:
    env.reset(seed=0)
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape))
    picture = env.render()
    env.close()
    return picture


def _count(picture: np.ndarray, colour: str) -> int:
    off = np.abs(picture - 255 * np.array(to_rgb(colour)))
    return int((off.max(axis=2) < 8).sum())


def test_the_ghost_stands_out_of_the_picture_when_the_arm_is_off() -> None:
    options = {"render_mode": "rgb_array", "motion": "pick", "episode_length": 2.0}
    good, bad = (_picture(ArmTracking(effects=x, **options)) for x in ((), PAYLOAD))
    for picture in (good, bad):
        assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
        assert _count(picture, ARM) > 3000 and _count(picture, GHOST) > 500
    assert _count(bad, GHOST) > 1.1 * _count(good, GHOST)


def test_no_mode_no_picture_and_a_single_joint_is_drawn_before_the_first_step(
    pendulum_urdf: Path,
) -> None:
    assert _picture(ArmTracking(), steps=0) is None
    drawn = ArmTracking(pendulum_urdf, render_mode="rgb_array", episode_length=0.2)
    assert drawn.render() is None
    assert _count(_picture(drawn, steps=0), ARM) > 500


def test_human_mode_without_a_display_goes_to_the_terminal(monkeypatch, capsys) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert isinstance(open_viewer("title", 0.02), TerminalViewer)
    shown = {"render_mode": "human", "episode_length": 0.1}
    assert _picture(ArmTracking(effects=(PAYLOAD,), **shown), steps=1) is None
    assert "payload" in capsys.readouterr().out


def test_terminal_shows_coloured_half_blocks() -> None:
    out = io.StringIO()
    colours = {"force_terminal": True, "color_system": "truecolor"}
    viewer = TerminalViewer(Console(file=out, width=100, **colours))
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[: HEIGHT // 2, :, 0] = 200
    viewer.show(picture, "the caption")
    viewer.show(picture, "too early")
    text = out.getvalue()
    assert text.count("▀") == 80 * 24 and "38;2;200;0;0" in text
    assert "the caption" in text and "too early" not in text
