"""From the terms a user asks for to what the kernels take."""

from __future__ import annotations

import numpy as np

from study.collision import CanonicalFrame
from study.errors import InputError
from study.planners.fitness.live import CuttingForce, IncidenceAngle
from study.planners.fitness.terms import FitnessTerm, field_at_candidate
from study.planners.simulation import _kernels as simulation
from study.planners.simulation.state._kernels import LiveBone
from study.volumes import LabelVolume, ball_element
from study.volumes.elements import element_rows

MOST_TERMS = 4


def _one_of(terms: tuple, kind: type) -> CuttingForce | IncidenceAngle | None:
    """The live term of a kind whose weight is not 0, if there is one."""
    found = [term for term in terms if isinstance(term, kind)]
    if len(found) > 1:
        raise InputError(f"terms: expected at most one {kind.__name__}, got {len(found)}")
    return found[0] if found and found[0].weight != 0 else None


def live_bone(terms: tuple, solid: np.ndarray, frame: CanonicalFrame, burr_radius: float) -> LiveBone:
    """What the live terms look at, before the milling; arrays that no term asks for have no elements.

    Parameters
    ----------
    terms : tuple
        ``PlannerSettings.terms``.
    solid : uint8 array
        Canonical, as in `Simulation`.
    frame : CanonicalFrame
    burr_radius : float
        mm.

    Raises
    ------
    InputError
        If the density's shape is not the volume's, or a kind of term is given twice.
    """
    force, incidence = _one_of(terms, CuttingForce), _one_of(terms, IncidenceAngle)
    density = np.zeros((0, 0, 0), np.uint16)
    load, ahead = np.zeros((0, 0, 0), np.int32), np.zeros((4, 0, 0, 0), np.int32)
    rows = np.zeros((0, 3), np.int64)
    if force or incidence:
        rows = element_rows(ball_element(burr_radius, frame.steps))
    if force:
        if force.density is None:
            density = np.full(solid.shape, 1000, np.uint16)
        else:
            values = np.asarray(force.density, dtype=float)
            if values.shape != frame.shape:
                raise InputError(f"density: expected the volume's shape {frame.shape}, got {values.shape}")
            density = frame.canonical(np.rint(1000 * values).astype(np.uint16))
        load = np.zeros(solid.shape, np.int32)
    if incidence:
        ahead = np.zeros((4, *solid.shape), np.int32)
    live = LiveBone(rows, density, load, ahead)
    if force or incidence:
        simulation.count_live(solid, live)
    return live


def compile_terms(terms: tuple, volume: LabelVolume, frame: CanonicalFrame) -> tuple:
    """What `rank_candidates` takes: the fixed terms' number, weights and canonical fields; what the
    live terms weigh; four compiled scores.

    Raises
    ------
    InputError
        If there are more than four fixed terms, or a field has another shape than the volume or is
        not finite, or something is no term.
    """
    force, incidence = _one_of(terms, CuttingForce), _one_of(terms, IncidenceAngle)
    fixed = [term for term in terms if not isinstance(term, CuttingForce | IncidenceAngle)]
    if len(fixed) > MOST_TERMS:
        raise InputError(f"terms: expected at most {MOST_TERMS} with a field, got {len(fixed)}")
    fields = []
    for term in fixed:
        if not isinstance(term, FitnessTerm):
            raise InputError(f"terms: expected FitnessTerm, CuttingForce or IncidenceAngle, got {term!r}")
        field = term.field(volume) if callable(term.field) else term.field
        field = np.asarray(field, dtype=np.float32)
        if field.shape != volume.shape or not np.isfinite(field).all():
            raise InputError(
                f"term {term.name!r}: expected a finite field of shape {volume.shape}, got {field.shape}"
            )
        fields.append(frame.canonical(field))
    stacked = np.stack(fields) if fields else np.zeros((0, 1, 1, 1), np.float32)
    weights = np.array([term.weight for term in fixed], dtype=float)
    scores = [term.score for term in fixed] + [field_at_candidate] * (MOST_TERMS - len(fixed))
    live = (
        float(force.weight) if force else 0.0,
        float(incidence.weight) if incidence else 0.0,
        bool(incidence.by_bone) if incidence else False,
    )
    return (len(fixed), weights, stacked, *live, *scores)
