"""The formulas of radiometry, each once.

Symbols: R range [m], E echo energy [DN ns], β beam divergence (full angle), θ incidence, ρ diffuse reflectance.

- Lidar equation: the energy that a target sends back is E = σ η g / (C_cal R⁴), σ its backscatter cross-section, η the
  transmission of the air over the way there and back, g the gain of the strip (Wagner 2006, eq. 9, where the system's
  and the air's losses are inside C_cal).
- A surface larger than the beam is lit over the area A_i / cos θ, A_i = π R² β² / 4 the beam's own cross-section. A
  matt (Lambertian) one of reflectance ρ has σ = 4 ρ A_i cos θ: 4 = 4π / π, as it scatters into an effective solid angle
  of π; one cosine, as the whole beam falls on the lit area, however large that is.
- γ = σ / (A_i cos θ) = 4 ρ on every such surface, whatever its range and slope.

The papers differ by cosines. With Wagner's γ_w = σ / A_i (per area of the beam) and radar's σ° (per lit area):
γ_w = γ cos θ, σ° = γ cos² θ. Fan 2013, eq. 3 writes γ = σ / (A_i cos θ) = C_cal R² P S_p; its right side has no cosine,
so its A_i is the lit area, and its γ is Wagner's. Here A_i is the beam's cross-section, and the cosine stays.

Sources: Wagner 2006 (ISPRS J. 60), Wagner 2010 (ISPRS J. 65), Fan 2013.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

WHITE = 4.0
"""γ of a white (ρ = 1) matt surface."""


def transmission(range_: NDArray[np.float64], extinction: float) -> NDArray[np.float64]:
    """η: share of the light that the air leaves over 2 R; `extinction` one way [dB/km]."""
    return np.asarray(10.0 ** (-2.0 * extinction * range_ / 10_000.0), np.float64)


def beam_area(range_: NDArray[np.float64], divergence: float) -> NDArray[np.float64]:
    """A_i [m²] at `range_` [m]; `divergence` full angle [mrad]."""
    return np.asarray(math.pi / 4.0 * (range_ * divergence * 1e-3) ** 2, np.float64)


def cross_section(energy: NDArray[np.float64], range_: NDArray[np.float64], extinction: float) -> NDArray[np.float64]:
    """σ / C_cal = R⁴ E / η, before the strip's gain; `energy` [DN ns].

    The area under an echo stands for its energy: a slope or rough surface widens the echo and lowers its peak, and
    keeps the area. Wagner's peak × standard deviation s_p is the area / √(2π) of a Gaussian echo, and peak × FWHM the
    area / 1.0645: such factors are the same for all echoes, and C_cal takes them.
    """
    return np.asarray(range_**4 * energy / transmission(range_, extinction), np.float64)


def backscatter(
    sigma: NDArray[np.float64], area: NDArray[np.float64], cosine: NDArray[np.float64]
) -> NDArray[np.float64]:
    """γ = σ / (A_i cos θ), (rows,), of σ [m²] and the area A_i [m²]; NaN where one of them is."""
    return np.asarray(sigma / (area * cosine), np.float64)


def reflectance(sigma: NDArray[np.float64], area: NDArray[np.float64]) -> NDArray[np.float64]:
    """10 log10 of σ over that of a white matt surface that faces the beam, 4 A_i [dB]; NaN where σ is not positive.

    The incidence is not taken out, as in RIEGL's `Reflectance`: a matt surface of ρ gives 10 log10(ρ cos θ).
    """
    share = sigma / (WHITE * area)
    known = share > 0.0
    return np.asarray(10.0 * np.log10(share, out=np.full(len(share), np.nan), where=known), np.float64)
