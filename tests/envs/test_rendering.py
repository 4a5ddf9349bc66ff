"""Rendering: what the picture shows, how fast, and where it goes without a display."""

import io

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


def _picture(steps: int = 40, **options: object) -> np.ndarray:
    env = ArmTracking(
        render_mode="rgb_array", motion="pick", episode_length=2.0, **options
    )
    env.reset(seed=0)
    for _ in range(steps):
        env.step(np.zeros(7))
    picture = env.render()
    env.close()
    return picture


def _count(picture: np.ndarray, colour: str) -> int:
    off = np.abs(picture - 255 * np.array(to_rgb(colour)))
    return int((off.max(axis=2) < 8).sum())


def test_picture_shows_arm_and_ghost_and_the_ghost_stands_out_when_the_arm_is_off() -> (
    None
):
    good, bad = _picture(), _picture(effects=(PAYLOAD,))
    for picture in (good, bad):
        assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
        assert _count(picture, ARM) > 3000 and _count(picture, GHOST) > 500
    assert _count(bad, GHOST) > 1.1 * _count(good, GHOST)


def test_no_mode_no_picture_and_a_picture_before_the_first_step() -> None:
    plain, drawn = ArmTracking(), ArmTracking(render_mode="rgb_array")
    plain.reset(seed=0)
    assert plain.render() is None and drawn.render() is None
    drawn.reset(seed=0)
    assert drawn.render() is not None
    plain.close()
    drawn.close()


def test_a_single_joint_can_be_drawn(pendulum_urdf) -> None:
    env = ArmTracking(pendulum_urdf, render_mode="rgb_array", episode_length=0.2)
    env.reset(seed=0)
    env.step(np.zeros(1))
    assert _count(env.render(), ARM) > 500
    env.close()


def test_human_mode_without_a_display_goes_to_the_terminal(monkeypatch, capsys) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert isinstance(open_viewer("title", 0.02), TerminalViewer)
    env = ArmTracking(render_mode="human", episode_length=0.1, effects=(PAYLOAD,))
    env.reset(seed=0)
    env.step(np.zeros(7))
    assert env.render() is None
    env.close()
    assert "payload" in capsys.readouterr().out


def test_terminal_shows_coloured_half_blocks() -> None:
    out = io.StringIO()
    viewer = TerminalViewer(
        Console(file=out, force_terminal=True, color_system="truecolor", width=100)
    )
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[: HEIGHT // 2, :, 0] = 200
    viewer.show(picture, "the caption")
    viewer.show(picture, "too early")
    text = out.getvalue()
    assert text.count("▀") == 80 * 24 and "38;2;200;0;0" in text
    assert "the caption" in text and "too early" not in text
