"""The benchmarks' machinery: rows from times, exponents, points that are stored, tables in a page, the pendulum."""

import sys

import pytest

from experiments.benchmarks import __main__ as benchmarks
from experiments.benchmarks.measure import (
    Point,
    Row,
    compared,
)


def test_ratio_is_the_median_of_the_rounds_ratios():
    times = {"ours": [1.0, 2.0, 5.0], "bare": [2.0, 2.0, 20.0]}
    ours, bare = compared(times, "bare", "µs", per=1e-6, what="step")
    assert (ours.name, ours.figure, ours.ratio) == ("step, ours", 2e6, 2.0)
    assert ours.spread == pytest.approx(1e6)  # quartiles 1.5 and 3.5 s
    assert ours.ratio_spread == pytest.approx(0.75)  # ratios 2, 1, 4
    assert (bare.ratio, bare.ratio_spread) == (1.0, 0.0)


@pytest.fixture
def part(monkeypatch):
    """A part with a point that succeeds and one that fails at first."""
    calls = []

    def measure(name, fails):
        calls.append(name)
        if fails and calls.count(name) == 1:
            raise ValueError("out of order")
        return [Row(f"row of {name}", 0.25, "s", ratio=2.0, yardstick="other")]

    module = type(sys)("experiments.benchmarks.fake")
    module.points = lambda settings: [
        Point("good", lambda: measure("good", False)),
        Point("bad", lambda: measure("bad", True)),
    ]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(benchmarks, "PARTS", {"fake": "A part"})
    return calls


def test_a_run_goes_on_where_it_was_and_writes_into_the_page(part, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    assert benchmarks.main(["fake", *out]) == 1
    assert "failed: fake: bad" in capsys.readouterr().err
    page = tmp_path / "page.md"
    page.write_text(
        "before\n<!-- fake: written by a script -->\nold\n<!-- end of fake -->\nafter\n"
    )
    assert benchmarks.main(["fake", *out, "--into", str(page)]) == 0
    assert part == ["good", "bad", "bad"]
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("-->\nafter\n")
    assert "| row of good | 0.25 s | 2 to other |  |" in text and "old" not in text
    benchmarks.main(["fake", *out, "--again", "--only", "good"])
    assert part == ["good", "bad", "bad", "good"]
