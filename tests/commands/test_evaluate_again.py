"""An evaluation from a file of the environment, and one that was interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from gapscope.agents.evaluation import TrackingBench
from gapscope.commands.evaluation_cells import FOLDER
from gapscope.provenance import fingerprint

Command = Callable[..., object]
FILE = """
robot: {robot}
effects: {effects}
engine: [pybullet]
motion: fourier
disturbances: none
seeds: 1
episode_length: 1.5
bandwidth: 3
action: residual
"""
QUICK = ("--motions", "fourier", "--duration", 1.5, "--disturbances", "none")


@pytest.fixture
def env(sick: Path, corrected: Path, tmp_path: Path) -> Path:
    """A file whose paths are relative to itself."""
    path = tmp_path / "env.yaml"
    path.write_text(FILE.format(robot=sick.name, effects=corrected.name))
    return path


def plan(out: Path) -> dict[str, object]:
    return json.loads((out / "evaluation.json").read_text())["plan"]


class TestEnvironmentFile:
    def test_stands_in_for_options(
        self, gapscope: Command, env: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        done = gapscope("evaluate", "nominal", "--env", env, "--out", out)
        assert done.code == 0, done.err
        content = json.loads((out / "evaluation.json").read_text())
        assert content["arm"]["joints"] == ["yaw", "pitch"]
        assert [effect["effect"] for effect in content["effects"]] == [
            "viscous_friction"
        ]
        said = {
            key: content["plan"][key]
            for key in ("motions", "disturbances", "seeds", "duration", "bandwidth")
        }
        assert said == {
            "motions": ["fourier"],
            "disturbances": ["none"],
            "seeds": [0],
            "duration": 1.5,
            "bandwidth": 3.0,
        }
        assert "ignored in an evaluation: action" in done.err

    def test_gives_the_same_as_options(
        self, gapscope: Command, env: Path, sick: Path, corrected: Path
    ) -> None:
        first, second = env.parent / "first", env.parent / "second"
        assert gapscope("evaluate", "nominal", "--env", env, "--out", first).code == 0
        options = (
            "--robot",
            sick,
            "--effects",
            corrected,
            *QUICK,
            "--seeds",
            1,
            "--bandwidth",
            3.0,
        )
        assert gapscope("evaluate", "nominal", *options, "--out", second).code == 0
        assert (first / "evaluation.json").read_bytes() == (
            second / "evaluation.json"
        ).read_bytes()

    def test_options_that_are_given_win(
        self, gapscope: Command, env: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        done = gapscope(
            "evaluate",
            "pd",
            "--env",
            env,
            "--out",
            out,
            "--bandwidth",
            4.0,
            "--robot",
            "kuka_iiwa",
        )
        assert done.code == 0, done.err
        content = json.loads((out / "evaluation.json").read_text())
        assert (
            content["plan"]["bandwidth"] == 4.0 and len(content["arm"]["joints"]) == 7
        )

    def test_a_sheet_makes_the_nominal_arm(
        self, gapscope: Command, sick: Path, tmp_path: Path
    ) -> None:
        env = tmp_path / "env.yaml"
        urdf = next(sick.glob("*.urdf"))
        env.write_text(f"robot: {sick.name}/{urdf.name}\nsheet: {{viscous: [3.0]}}\n")
        done = gapscope(
            "evaluate", "nominal", "--env", env, "--out", tmp_path / "out", *QUICK
        )
        assert (
            done.code == 2
            and "expected 2 numbers" in done.err
            and "env.yaml" in done.err
        )

    def test_the_registered_name_means_the_defaults(
        self, gapscope: Command, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        done = gapscope(
            "evaluate",
            "pd",
            "--env",
            "gapscope/ArmTracking-v0",
            *QUICK,
            "--seeds",
            1,
            "--out",
            out,
        )
        assert done.code == 0, done.err
        assert plan(out)["bandwidth"] == 4.0 and plan(out)["engines"] == ["pybullet"]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("robto: kuka_iiwa", "did you mean 'robot'"),
            ("seeds: many", "a whole number from 1 on"),
            ("engine: 3", "a name or a list of names"),
            ("bandwidth: true", "a number"),
            ("robot: kuka_iiwa\ncase: sick", "leave robot: and sheet: out"),
            ("motion: fourier\nmotions: pick", "says the same as motions"),
            ("randomisation: {count: 3}", "draws no effects"),
            ("- robot", "expected keys"),
            ("robot: [", "not valid YAML"),
            ("robot: kuka_iwa", "did you mean 'kuka_iiwa'"),
            ("effects: missing.yaml", "missing.yaml"),
            ("law: fuzzy", "fuzzy"),
        ],
    )
    def test_bad_input_is_told(
        self, gapscope: Command, tmp_path: Path, text: str, message: str
    ) -> None:
        path = tmp_path / "env.yaml"
        path.write_text(text)
        done = gapscope("evaluate", "pd", "--env", path, "--out", tmp_path / "out")
        assert done.code == 2 and message in done.err and "Traceback" not in done.err

    def test_a_name_that_is_near_is_offered(
        self, gapscope: Command, tmp_path: Path
    ) -> None:
        done = gapscope(
            "evaluate",
            "pd",
            "--env",
            "gapscope/ArmTraking-v0",
            "--out",
            tmp_path / "out",
        )
        assert done.code == 2 and "did you mean 'gapscope/ArmTracking-v0'" in done.err


class UnpluggedError(Exception):
    """Somebody pulls the plug."""


class TestInterrupted:
    @pytest.fixture
    def counted(self, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
        """How many cells were worked on; at ``limit`` the plug is pulled."""
        state = {"done": 0, "limit": 10**6}
        for name in ("episodes", "margin"):
            real = getattr(TrackingBench, name)

            def counting(
                self: TrackingBench,
                *arguments: object,
                real: Callable[..., object] = real,
            ) -> object:
                if state["done"] >= state["limit"]:
                    raise UnpluggedError
                state["done"] += 1
                return real(self, *arguments)

            monkeypatch.setattr(TrackingBench, name, counting)
        return state

    def test_goes_on_where_it_was(
        self,
        gapscope: Command,
        sick: Path,
        corrected: Path,
        tmp_path: Path,
        counted: dict[str, int],
    ) -> None:
        models, options = (
            ("pd", "nominal", corrected),
            ("--robot", sick, "--effects", corrected, *QUICK, "--seeds", 2),
        )
        assert (
            gapscope("evaluate", *models, *options, "--out", tmp_path / "whole").code
            == 0
        )
        out, counted["limit"], counted["done"] = tmp_path / "out", 5, 0
        with pytest.raises(UnpluggedError):
            gapscope("evaluate", *models, *options, "--out", out)
        assert (
            len(list((out / FOLDER).iterdir())) == 5
            and not (out / "evaluation.json").exists()
        )

        counted["limit"], counted["done"] = 10**6, 0
        done = gapscope("evaluate", *models, *options, "--out", out)
        assert (
            done.code == 0
            and counted["done"] == 4
            and "5 parts were taken" in " ".join(done.err.split())
        )
        for name in ("evaluation.json", "evaluation.csv"):
            assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
        assert not (out / FOLDER).exists()

    @pytest.mark.parametrize(
        "change", ["effects", "model", "plan", "robot", "again", "damaged"]
    )
    def test_what_is_kept_is_not_used_for_anything_else(
        self,
        gapscope: Command,
        sick: Path,
        corrected: Path,
        tmp_path: Path,
        counted: dict[str, int],
        change: str,
    ) -> None:
        model, out = tmp_path / "model.yaml", tmp_path / "out"
        model.write_text(corrected.read_text())
        command = [
            "evaluate",
            model,
            "--robot",
            sick,
            "--effects",
            corrected,
            *QUICK,
            "--seeds",
            2,
            "--out",
            out,
        ]
        counted["limit"] = 2
        with pytest.raises(UnpluggedError):
            gapscope(*command)
        if change == "effects":
            corrected.write_text(corrected.read_text().replace("3.0", "2.5"))
        elif change == "model":
            model.write_text(model.read_text().replace("3.0", "2.5"))
        elif change == "plan":
            command += ["--damping", 0.8]
        elif change == "robot":
            urdf = next(sick.glob("*.urdf"))
            urdf.write_text(
                urdf.read_text().replace('mass value="4"', 'mass value="4.1"')
            )
        elif change == "again":
            command += ["--again"]
        else:
            for file in (out / FOLDER).iterdir():
                file.write_text(file.read_text()[:40])
        counted["limit"], counted["done"] = 10**6, 0
        done = gapscope(*command)
        assert (
            done.code == 0
            and counted["done"] == 3
            and "were taken" not in " ".join(done.err.split())
        )

    def test_other_models_engines_and_seeds_may_be_added(
        self, gapscope: Command, sick: Path, tmp_path: Path, counted: dict[str, int]
    ) -> None:
        command = ["--robot", sick, *QUICK, "--out", tmp_path / "out"]
        counted["limit"] = 1
        with pytest.raises(UnpluggedError):
            gapscope("evaluate", "pd", *command, "--seeds", 2)
        counted["limit"], counted["done"] = 10**6, 0
        assert gapscope("evaluate", "nominal", "pd", *command, "--seeds", 1).code == 0
        assert counted["done"] == 3


def test_fingerprint_tells_what_differs() -> None:
    values = [1, 1.0, "1", (1,), ((1,),), (1, 1), {"a": 1}, {"b": 1}, None, True]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
