"""Export a corrected arm for other simulators."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.controller import Controller
from gapscope.arm.io.atomic_write import make_folder
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.export.formats import export as write_arm
from gapscope.interface.result import Result


@dataclass(frozen=True, repr=False)
class ExportResult(Result):
    """A file for another simulator.

    Attributes:
        corrected: the arm in it.
        file: the file.
        format: one of ``gapscope.envs.export.formats.ALL_FORMATS``.
        left_out: effects that the format cannot hold; a sentence each.
        remarks: what is odd about the bodies; a sentence each.
        controller: whose gains are in it, or ``None``.
    """

    COLUMNS = ("kind", "text")

    corrected: CorrectedArm
    file: Path
    format: str
    left_out: tuple[str, ...]
    remarks: tuple[str, ...]
    controller: Controller | None = None

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the file, under the same name, into another folder."""
        make_folder(Path(folder))
        file = Path(folder) / self.file.name
        write_arm(self.corrected, self.format, file, controller=self.controller)
        return (file,)

    def shown(self) -> str:
        """The file, what it leaves out, and remarks."""
        notes = [f"left out: {text}" for text in self.left_out]
        return "\n".join([str(self.file), *notes, *self.remarks])

    def table(self) -> Iterator[tuple[str, str]]:
        """A row for each effect that is left out, and each remark."""
        yield from (("left out", text) for text in self.left_out)
        yield from (("remark", text) for text in self.remarks)


def export(
    corrected: CorrectedArm,
    file: str | Path,
    format: str | None = None,
    controller: Controller | None = None,
) -> ExportResult:
    """Write a corrected arm as URDF, MJCF or SDF, or as a snippet in the words of a simulator.

    Args:
        corrected: of a diagnosis (``result.corrected``) or a file (``gapscope.read_corrected``).
        file: the file to write.
        format: ``urdf``, ``mjcf`` or ``sdf``, by default as the ending of ``file`` says; or ``isaac_lab``, ``mjlab``,
            ``newton``, ``genesis``, ``drake``, ``gazebo``, ``ros2_control``.
        controller: of the case (``case.controller``), whose gains a snippet then holds.

    Raises:
        InputError: no such format, or an effect that no arm can have.
        GapscopeError: the file cannot be written.

    Examples:
        >>> import gapscope, tempfile, pathlib
        >>> from gapscope.effects.corrected import CorrectedArm
        >>> arm = CorrectedArm(gapscope.make_arm("kuka_iiwa"))
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "arm.urdf"
        >>> gapscope.export(arm, file).left_out
        ()
    """
    file = Path(file)
    ending = file.suffix.removeprefix(".")
    form = format or {"xml": "mjcf"}.get(ending, ending)
    left_out, remarks = write_arm(corrected, form, file, controller=controller)
    return ExportResult(corrected, file, form, left_out, remarks, controller)
