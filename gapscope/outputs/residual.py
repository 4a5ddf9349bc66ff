"""A learnt residual network as files: the network, the corrected arm that names it, report and document."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gapscope.effects.corrected_file import write_corrected
from gapscope.effects.residual.file import write_residual
from gapscope.ident.residual.document import document, write_document
from gapscope.ident.residual.learnt import LearntResidual
from gapscope.reports.residual.page import write_page

DOCUMENT, REPORT = "residual.json", "report.html"
NETWORK, CORRECTED, ONNX = "residual.npz", "corrected.yaml", "residual.onnx"


def write_learnt(
    found: LearntResidual,
    folder: Path,
    *,
    onnx: bool = False,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """Write the network, ``corrected.yaml`` with it, the report and, as the last, ``residual.json``.

    Args:
        found: what was learnt.
        folder: of the results.
        onnx: write ``residual.onnx`` as well.
        progress: called with a few words at each step.

    Returns:
        The document, and the paths, the report first.

    Raises:
        GapscopeError: a file cannot be written, or the package onnx is wanted and not installed.
    """
    files = {"report": REPORT, "corrected": CORRECTED, "network": NETWORK}
    if onnx:
        from gapscope.ident.residual.export import onnx_model

        progress("writes ONNX")
        onnx_model(found.residual, folder / ONNX)
        files["onnx"] = ONNX
    progress("writes the report")
    write_residual(found.residual, folder / NETWORK)
    corrected = found.corrected
    write_corrected(
        found.case.name,
        corrected.effects,
        folder / CORRECTED,
        NETWORK,
        states=corrected.states,
    )
    content = document(found, files)
    write_page(content, folder / REPORT)
    write_document(content, folder / DOCUMENT)
    return content, tuple(folder / name for name in (*files.values(), DOCUMENT))
