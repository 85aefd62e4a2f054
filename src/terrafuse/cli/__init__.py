"""The command line: parse, call, print. The only place that prints.

Heavy rooms are imported inside the commands, so that `--help` answers at once.
"""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from terrafuse import __version__
from terrafuse.cli import commands, compare, importing, keys, models, plan, services, simulate
from terrafuse.cli.output import fail
from terrafuse.errors import InputError, TerrafuseError
from terrafuse.plugins import blamed

app = typer.Typer(
    name="terrafuse",
    help="One terrain map from many robots.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(simulate.demo)
app.command("map")(commands.map_)
app.command("info")(commands.info)
app.command("export")(commands.export)
app.command("import")(importing.import_)
app.command("compare")(compare.compare_)
app.command("plan")(plan.plan_)
app.command("simulate")(simulate.simulate)
app.command("models")(models.models_)
app.add_typer(keys.keys_app, name="keys")
app.command("station")(services.station)
app.command("robot")(services.robot)
app.command("fleet")(services.fleet)
app.command("services")(services.services)
app.command("get")(services.get)
app.command("correct")(services.correct)


INTERRUPTED = 130


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
    as_json = "--json" in sys.argv
    try:
        code = app(standalone_mode=False) or 0  # the parser makes INTERRUPTED of a KeyboardInterrupt itself
        code = _interrupted() if code == INTERRUPTED else code
    except TerrafuseError as error:
        code = fail(error, as_json)
    except (KeyboardInterrupt, typer.Abort):
        code = _interrupted()
    except Exception as error:
        if theirs := blamed(error):
            code = fail(theirs, as_json)
        elif hasattr(error, "format_message"):
            code = _wrong_use(error, as_json)
        else:
            raise
    sys.exit(code)


def _interrupted() -> int:
    print("interrupted; what was committed is kept, and the same command goes on from there", file=sys.stderr)
    return INTERRUPTED


def _wrong_use(error: Any, as_json: bool) -> int:
    """The parser's complaint about an option; returns the exit code."""
    if as_json:
        return fail(InputError(error.format_message() or "wrong use; see --help"), as_json)
    error.show()
    return int(error.exit_code)
