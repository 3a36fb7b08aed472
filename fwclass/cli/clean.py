"""`fwclass clean`: room, once a run has delivered."""

from __future__ import annotations

from typing import Any

import click

from fwclass.cli.base import RUN, cli
from fwclass.cli.run_words import run_at


@cli.command()
@click.argument("run", type=RUN)
@click.option(
    "--keep",
    type=click.Choice(["delivery", "deliveries", "latest"]),
    required=True,
    help="delivery: only what readers see now; deliveries: the earlier ones too, no parts; latest: what readers see "
    "now, and the parts that the next run goes on from.",
)
def clean(run: Any, keep: Any) -> None:
    """Remove earlier deliveries of a run, or the parts that they were made from, or both.

    What was delivered stays as it is; the next run makes all that is missing. An earlier delivery stays, too, where the
    current one, of another workflow, lacks what it has.
    """
    from fwclass.operate.clean import clean as remove

    gone = remove(run_at(run), keep, lambda text: click.echo(text, err=True))
    some = ", ".join(gone.generations) or "none"
    click.echo(f"generations {some} removed")
    for name, products in gone.unique.items():
        click.echo(f"generation  {name} stays: it alone has {', '.join(products)}")
    click.echo(f"parts       {gone.parts:,} removed")
    click.echo(f"size        {gone.freed}")
