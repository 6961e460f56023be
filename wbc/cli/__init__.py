"""The commands, a file each. Heavy imports stand inside them, so that `wbc --help` answers at once.

Exit status: 0 all held; 1 it ran and a bound failed; 2 bad input. With `--json` one object goes to stdout, all else to
stderr.
"""

from __future__ import annotations

import click

from .. import __version__
from .campaign import campaign
from .check import check
from .compare import compare
from .doctor import doctor
from .explain import explain
from .replay import replay
from .run import run
from .schema import schema
from .verify import verify


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="wbc")
def main() -> None:
    """Whole-body contact control from a YAML spec: run it, check it, verify it against the closed form."""


for _command in (run, check, verify, explain, compare, replay, campaign, schema, doctor):
    main.add_command(_command)
