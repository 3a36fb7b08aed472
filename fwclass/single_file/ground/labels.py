"""Which points of a labelled cloud are ground, and how a filter's flags compare."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.errors import InputError
from fwclass.graph.ground_trial import truth_of
from fwclass.neighbours import Points
from fwclass.read.cloud import PointCloud, read_point_cloud
from fwclass.single_file.pairing import pairs


def labels_of(cloud: PointCloud, reference: Path | None = None) -> NDArray[np.int8]:
    """1 for points that are ground by their class, 0 for others, -1 where it is not known.

    `InputError`: there are not both ground and other points among the classes.
    """
    classes = cloud.classes if reference is None else _from_file(cloud, reference)
    truth = truth_of(classes, cloud.usable & ~cloud.flagged)
    if not ((truth == 1).any() and (truth == 0).any()):
        raise InputError(
            "the points have no reference",
            where=reference or cloud.path,
            expected="class 2 on ground and other classes elsewhere, or a text with labels 0 (ground) and 1",
            got=f"{int((truth == 1).sum()):,} ground and {int((truth == 0).sum()):,} other points",
            do="name a labelled file with --reference",
        )
    return truth


def _from_file(cloud: PointCloud, reference: Path) -> NDArray[np.uint8] | None:
    """The classes of the points of `cloud` by another file: in the same order, or by nearest point."""
    other = read_point_cloud(reference)
    if other.classes is None:
        return None
    rows = pairs(_places(cloud), _places(other), conf.section("label").max_distance)
    return np.where(rows >= 0, other.classes[rows], 0).astype(np.uint8)


def _places(cloud: PointCloud) -> Points:
    """Coordinates, NaN for points that cannot be used."""
    x, y, z = (np.where(cloud.usable, a, np.nan) for a in (cloud.x, cloud.y, cloud.z))
    return x, y, z
