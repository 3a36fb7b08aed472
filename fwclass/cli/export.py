"""`fwclass export`: a trained model for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from fwclass.cli.base import OVERWRITE, PATH, cli
from fwclass.errors import ConfigError


@cli.command()
@click.argument("model", type=PATH)
@click.argument("out", type=PATH)
@click.option("--format", "form", type=click.Choice(["onnx"]), default="onnx", show_default=True, help="File format.")
@OVERWRITE
def export(model: Path, out: Path, form: str, overwrite: bool) -> None:
    """Write the forest in the directory MODEL as the file OUT, for programs that read its format.

    ONNX: input X, float32 (rows, features) in the order of the metadata entry "features", NaN where a value is
    missing; outputs label (class codes), votes and probabilities. Classes are the same as here for every row.
    """
    from fwclass.publish.onnx_forest import onnx_forest
    from fwclass.single_file.ground.output import check_places
    from fwclass.store.atomic import move_into_place, staged
    from fwclass.store.models import load_forest

    if out.suffix.lower() != f".{form}":
        raise ConfigError(
            f"the output is {form.upper()}",
            where=out,
            expected=f"a name that ends in .{form}",
            got=out.suffix or "no suffix",
            do="name the output with this ending",
        )
    check_places(model, [out], overwrite)
    content = onnx_forest(load_forest(model))
    with staged(out.parent) as directory:
        (directory / out.name).write_bytes(content)
        move_into_place(directory / out.name, out)
    click.echo(f"{out}: {form}, {out.stat().st_size / 1e6:.1f} MB", err=True)
