"""Several cases in one run: one sub-folder each, and a summary."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from joblib import Parallel, delayed, parallel_config
from rich.console import Console

from arm.errors import GapscopeError, InputError
from diagnosis.report.summary import SummaryRow, render_summary
from gapscope.run import diagnose_one_of_many, make_folder


def diagnose_all(
    cases: list[Path], out: Path, jobs: int, backend: str, progress: Callable[[str], None], console: Console
) -> int:
    """Diagnose cases and write ``summary.html``; a case that fails does not stop the others.

    Returns:
        The exit code: 0, or the largest of the cases that failed.

    Raises:
        InputError: unknown backend.
        GapscopeError: Ray is not installed, or ``out`` cannot be written.
    """
    make_folder(out)
    folders = _folders(cases)
    rows: list[SummaryRow] = []
    codes = [0]
    with parallel_config(backend=_backend(backend), n_jobs=jobs):
        work = (
            delayed(diagnose_one_of_many)(str(case), out, folder) for case, folder in zip(cases, folders, strict=True)
        )
        for row, code in Parallel(return_as="generator")(work):
            rows.append(row)
            codes.append(code)
            progress(f"{len(rows)} of {len(cases)} done, {row.name}: {row.verdict.lower()}")
            console.print(f"{row.name}: {row.failure or _line(row)}", highlight=False, markup=False, soft_wrap=True)
    render_summary(rows, out / "summary.html")
    return max(codes)


def _line(row: SummaryRow) -> str:
    effects = "; ".join(f"{name}, {where}" for name, where in row.effects)
    return f"{row.verdict}. {effects}".strip()


def _folders(cases: list[Path]) -> list[str]:
    """A name for the results of each case: that of its folder or file, numbered where it repeats."""
    names: list[str] = []
    for case in cases:
        path = case.resolve()
        name = path.parent.name if path.name == "case.yaml" else path.stem
        names.append(name if name not in names else f"{name}-{len(names) + 1}")
    return names


def _backend(name: str) -> str:
    if name == "local":
        return "loky"
    if name != "ray":
        raise InputError(f"unknown backend {name!r}", "use local or ray", where="--backend")
    try:
        from ray.util.joblib import register_ray
    except ImportError:
        raise GapscopeError("ray is not installed", "pip install ray, or use --backend local") from None
    register_ray()
    return "ray"
