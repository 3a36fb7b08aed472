"""Tolerances that several tests share: how far two right answers may lie apart, with its unit and the reason.

A tolerance of one test alone stands there.
"""

FLOAT32_RTOL = 1e-6
"""Relative. A column of float32 keeps 24 bits, 6e-8; some operations with such numbers lose a digit more."""

FLOAT32_CHAIN_RTOL = 1e-5
"""Relative. A number made of several float32 columns, or of one after a subtraction."""

FLOAT32_UNIT = 1e-6
"""No unit. Shares, cosines and unit vectors kept as float32, and sums of a few of them."""

FLOAT64_UNIT = 1e-12
"""No unit. Shares, scores and unit vectors of order 1 in float64, summed in another order."""

FLOAT32_HEIGHT = 1e-4
"""[m] What float32 leaves of heights up to some 300 m, with the rounding of thinned places to a millimetre."""

COORDINATE = 1e-6
"""[m] What float64 leaves of distances and heights between coordinates of millions of metres."""

SMALL_COORDINATE = 1e-9
"""[m] What float64 leaves of heights and distances up to some hundred metres."""

MILLIMETRE = 0.00051
"""[m] Rounding to whole millimetres, which files and tables keep: half of one, and float64's part."""

FEATURE_RTOL = 2e-5
"""Relative. Features against numpy and scipy: float32, after roots of eigenvalues of float64."""

ATTRIBUTE_STEP = 1e-3
"""[DN, ns] Amplitudes and widths are summed in steps of 1/1024."""
