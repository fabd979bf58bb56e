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
from jaxgeo.cli._screen import print_message, stderr

MOST_TOLD = 5  # failed parts that are printed


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClusterOptions(OptionGroup):
    """Where a long command runs, and whether it completes an earlier run."""

    panel: ClassVar[str | None] = "Many machines"

    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="WHERE",
            help="Run on Dask: local, local:N (workers), tcp://HOST:PORT or a scheduler file; -o is then a folder.",
        ),
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="With --cluster: compute only what is missing in the output folder.")
    ] = False

    def check(self, output: pathlib.Path | None, **others: bool) -> None:
        """Raises `UserError` for an unknown kind of cluster, an unsuitable output, `others` (options given, by name)
        that do not apply, and --resume alone."""
        if self.cluster is None:
            if self.resume:
                raise UserError("--resume needs --cluster; other runs are short, or divided by --shard.")
            return
        from jaxgeo.cluster.client import check_name

        for name in (name for name, is_given in others.items() if is_given):
            raise UserError(f"--{name.replace('_', '-')} does not go with --cluster; leave it out.")
        with _told(self.cluster):
            check_name(self.cluster)
        if output is None:
            raise UserError("--cluster needs --output FOLDER, for the parts of the result.")
        check_writable(output)
        if not self.resume and output.exists() and any(output.iterdir()):
            raise UserError(
                f"--output {output}: not empty; give --resume to complete an earlier run, or name another folder."
            )

    @contextlib.contextmanager
    def connected(self) -> Iterator[Any]:
        """A client of Dask; the address of its dashboard is printed on stderr."""
        from jaxgeo.cluster import connect

        assert self.cluster is not None
        with contextlib.ExitStack() as stack:
            with _told(self.cluster):
                client = stack.enter_context(connect(self.cluster))
            if client.dashboard_link:
                print_message(f"dashboard: {client.dashboard_link}")
            yield client

    @property
    def shows_progress(self) -> bool:
        """Whether stderr is a terminal."""
        return stderr().is_terminal


@contextlib.contextmanager
def _told(cluster: str) -> Iterator[None]:
    """Raise what `connect` raises as `UserError`, in the words of the option."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise UserError(str(error).replace(f'cluster "{cluster}"', f"--cluster {cluster}")) from error


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
