"""`wbc schema`: the JSON Schema of a spec."""

from __future__ import annotations

import json

import click


@click.command()
@click.option("--json", is_flag=True, expose_value=False, help="It is one JSON object anyway.")
def schema() -> None:
    """Print the JSON Schema of a spec, for editors."""
    from ..spec import json_schema

    click.echo(json.dumps(json_schema(), indent=1))
