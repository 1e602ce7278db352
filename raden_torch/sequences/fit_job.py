"""A model of each of many measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from raden_torch.brdf.files.model_file import save_model
from raden_torch.brdf.fitting.settings import FitSettings
from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError
from raden_torch.files import write_once
from raden_torch.sequences.job import Job

if TYPE_CHECKING:
    from raden_torch.measurement import BrdfMeasurement


@dataclass(frozen=True)
class FitJob(Job[Path, "BrdfMeasurement | None", "BrdfMeasurement", Any]):
    """`raden fit *.csv -o FOLDER/`: shell.csv becomes FOLDER/shell.safetensors.

    Attributes:
        folder: of the models.
        settings: for all of them.
        validation: readings off the grid, by which each model's interpolation is chosen.
        force: replace models that are there.
    """

    folder: Path
    settings: FitSettings
    validation: Path | None = None
    force: bool = False

    @property
    def shared(self) -> tuple[Path, ...]:
        return () if self.validation is None else (self.validation,)

    def relocated(self, places: Mapping[Path, Path]) -> Self:
        return replace(self, validation=places.get(self.validation or Path(), self.validation))

    def inputs(self, item: Path) -> tuple[Path, ...]:
        return (item,)

    def output(self, item: Path) -> Path:
        return self.folder / f"{item.name.partition('.')[0]}.safetensors"

    def prepare(self) -> BrdfMeasurement | None:
        return None if self.validation is None else load_measurement(self.validation)

    def is_done(self, item: Path) -> bool:
        return self.output(item).exists() and not self.force

    def read(self, prepared: BrdfMeasurement | None, item: Path) -> BrdfMeasurement:
        return load_measurement(item)

    def work(self, prepared: BrdfMeasurement | None, read: BrdfMeasurement) -> Any:
        return self.settings.fitted(read, prepared).model

    def write(self, prepared: BrdfMeasurement | None, worked: Any, item: Path) -> bool:
        def save(path: Path) -> None:
            save_model(worked, path)

        self.folder.mkdir(parents=True, exist_ok=True)
        return write_once(self.output(item), save, replace=self.force)

    def check(self, items: Sequence[Path]) -> None:
        """Raise InputError for two measurements of one name, or one that would be overwritten."""
        by_output: dict[Path, Path] = {}
        for item in items:
            output = self.output(item)
            if output in by_output:
                raise InputError(
                    f"{self.folder}: expected a different name for each measurement, got "
                    f"{by_output[output]} and {item}, which both become {output.name}"
                )
            by_output[output] = item
