"""Greek letters in the names of angles and rates: ``alpha4`` is read as α4, its derivative as α̇4."""

from __future__ import annotations

import re

LETTERS = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "epsilon": "ε",
    "zeta": "ζ",
    "eta": "η",
    "theta": "θ",
    "kappa": "κ",
    "lambda": "λ",
    "mu": "μ",
    "nu": "ν",
    "xi": "ξ",
    "rho": "ρ",
    "sigma": "σ",
    "tau": "τ",
    "phi": "φ",
    "chi": "χ",
    "psi": "ψ",
    "omega": "ω",
    "Gamma": "Γ",
    "Delta": "Δ",
    "Theta": "Θ",
    "Lambda": "Λ",
    "Phi": "Φ",
    "Psi": "Ψ",
    "Omega": "Ω",
}

# Combining marks of an angle, its rate and its acceleration.
DOTS = ("", "\u0307", "\u0308")

_LETTER = re.compile(rf"(?<![A-Za-z])({'|'.join(LETTERS)})(?![A-Za-z])")


def greek(name: str) -> str:
    """Return a signal name with its Greek letters as letters: ``alpha4`` is α4, ``q_theta`` is q_θ."""
    return _LETTER.sub(lambda found: LETTERS[found[0]], name)
