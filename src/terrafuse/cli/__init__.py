"""The command line: parse, call, print. The only place that prints.

Heavy rooms are imported inside the commands, so that `--help` answers at once.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from terrafuse import __version__
from terrafuse.cli import commands
from terrafuse.cli.output import fail
from terrafuse.errors import TerrafuseError

app = typer.Typer(
    name="terrafuse",
    help="One terrain map from many robots.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(commands.demo)
app.command("map")(commands.map_)
app.command("info")(commands.info)
app.command("export")(commands.export)


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Entry point. Exit code 0 done, 1 failed, 2 wrong use or bad input, 130 interrupted."""
    try:
        app()
    except TerrafuseError as error:
        sys.exit(fail(error, as_json="--json" in sys.argv))
    except KeyboardInterrupt:
        print("interrupted; what was committed is kept, and the same command goes on from there", file=sys.stderr)
        sys.exit(130)
