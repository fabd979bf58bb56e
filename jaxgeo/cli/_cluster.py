"""Option `--cluster`: a long command on the workers of Dask, its results in a folder of parts."""

from __future__ import annotations

import contextlib
import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

import typer

from jaxgeo.cli._common import UserError, check_writable
from jaxgeo.cli._options import OptionGroup
from jaxgeo.cli._screen import is_quiet, print_message, print_note, stderr

MOST_TOLD = 5  # failed parts that are printed
# Endings of files; other outputs are folders.
FILES = (".tif", ".tiff", ".vrt", ".csv", ".geojson", ".gpkg", ".parquet", ".kml", ".kmz", ".gpx", ".json")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClusterOptions(OptionGroup):
    """Where a long command runs."""

    panel: ClassVar[str | None] = "Many machines"

    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="WHERE",
            help="Run on Dask: local, local:N (workers), tcp://HOST:PORT or a scheduler file.",
        ),
    ] = None

    def check(self, **others: bool) -> None:
        """Raises `UserError` for an unknown kind of cluster, and `others` (options given, by name) beside it."""
        if self.cluster is None:
            return
        from jaxgeo.cluster.client import check_name

        for name in (name for name, is_given in others.items() if is_given):
            raise UserError(f"--{name.replace('_', '-')} does not go with --cluster; leave it out.")
        with _told(self.cluster):
            check_name(self.cluster)

    @contextlib.contextmanager
    def connected(self) -> Iterator[Any]:
        """A client of Dask, the address of whose dashboard is printed on stderr; None without --cluster."""
        if self.cluster is None:
            yield None
            return
        from jaxgeo.cluster import connect

        with contextlib.ExitStack() as stack:
            with _told(self.cluster):
                client = stack.enter_context(connect(self.cluster))
            if client.dashboard_link:
                print_note(f"dashboard: {client.dashboard_link}")
            yield client

    @property
    def shows_progress(self) -> bool:
        """Whether stderr is a terminal, and --quiet is not given."""
        return stderr().is_terminal and not is_quiet()


@dataclasses.dataclass(frozen=True, kw_only=True)
class PartsOptions(ClusterOptions):
    """Where a long command runs that writes a folder of parts, and whether it completes an earlier run."""

    resume: Annotated[
        bool, typer.Option("--resume", help="Compute only what is missing in the output folder of an earlier run.")
    ] = False

    def check_parts(self, in_parts: bool, **others: bool) -> None:
        """Raises `UserError` as `check`, and for --resume of a result that is not `in_parts`."""
        if self.resume and not in_parts:
            raise UserError("--resume completes a folder of parts, and this result is one file; leave it out.")
        self.check(**others)

    def check_folder(self, output: pathlib.Path | None) -> pathlib.Path:
        """The folder of the parts. Raises `UserError` without one, or if it is not empty and not to be resumed."""
        if output is None:
            raise UserError("--cluster needs --output FOLDER, for the parts of the result.")
        if output.suffix.lower() in FILES and not output.is_dir():
            raise UserError(f"--output {output}: the result has several files; name a folder for them.")
        check_writable(output)
        if not self.resume and output.exists() and any(output.iterdir()):
            raise UserError(
                f"--output {output}: not empty; give --resume to complete an earlier run, or name another folder."
            )
        return output


@contextlib.contextmanager
def _told(cluster: str) -> Iterator[None]:
    """Raise what `connect` raises as `UserError`, in the words of the option."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise UserError(str(error).replace(f'cluster "{cluster}"', f"--cluster {cluster}")) from error


def print_missing(run: Any) -> None:
    """Print how many parts of a run were missing, if others were there."""
    if run.computed < len(run.parts):
        print_note(f"{run.computed} of {len(run.parts)} parts were missing; the others were there.")


@contextlib.contextmanager
def report_failed_parts() -> Iterator[None]:
    """Raise failed parts as `UserError`, after the reasons of the first ones."""
    from jaxgeo.cluster import PartsFailed

    try:
        yield
    except PartsFailed as error:
        for name, reason in list(error.failed.items())[:MOST_TOLD]:
            print_message(f"{name}: {reason}")
        raise UserError(
            f"--output {error.folder}: {len(error.failed)} of {error.total} parts failed; the others are whole. Run "
            f"again with --resume for the missing ones."
        ) from error
