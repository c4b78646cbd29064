"""The health of lights, skin and gel as a face shows it."""

from __future__ import annotations

from collections.abc import Iterator

from device.health_limits import DEFECTS_DOUBTFUL, FLAT_RESIDUAL_UM, GEL_PRESSES, STALE_EVIDENCE_SCANS
from device.scanning.scan_health import ScanHealth, ZeroCheck
from device.session.state import GelState, HealthState
from device.verdict import drift_complaints


def health_state(health: ScanHealth, gel: GelState, zero: ZeroCheck | None) -> HealthState:
    """The present health, and the first thing that is wrong with it.

    zero : the last zero check under this calibration
    """
    complaints = list(_complaints(health, gel, zero))
    return HealthState(
        light_change=health.light_change,
        scans_unseen=health.unseen_scans,
        reference_change=health.reference_change,
        defect_share=health.defect_share,
        flat_residual_um=zero.flat_residual_um if zero else None,
        level="doubtful" if complaints else "good",
        sentence=complaints[0] if complaints else _praise(health),
    )


def zero_sentence(zero: ZeroCheck) -> str:
    """What a zero check says, with its number."""
    if zero.flat_residual_um <= FLAT_RESIDUAL_UM:
        return f"Zero check passed: untouched skin reads flat to {zero.flat_residual_um:.1f} µm."
    return (
        f"Zero check failed: untouched skin reads flat to {zero.flat_residual_um:.1f} µm only, {FLAT_RESIDUAL_UM:g} µm "
        "are allowed. Touch nothing, wipe the gel, and calibrate if it stays."
    )


def _complaints(health: ScanHealth, gel: GelState, zero: ZeroCheck | None) -> Iterator[str]:
    for _, reason in drift_complaints(health.light_change, health.reference_change):
        yield reason
    if health.defect_share > DEFECTS_DOUBTFUL:
        yield f"{health.defect_share:.1%} of the skin is scratched or dirty: wipe the gel or change it"
    if zero and zero.flat_residual_um > FLAT_RESIDUAL_UM:
        yield zero_sentence(zero)
    if health.unseen_scans > STALE_EVIDENCE_SCANS:
        yield f"untouched skin was not seen for {health.unseen_scans} scans: lift off, or make a zero check"
    if gel.presses > GEL_PRESSES:
        yield f"gel {gel.gel_id} was pressed {gel.presses} times: look at its coat"


def _praise(health: ScanHealth) -> str:
    changes = [abs(change) for change in health.light_change.values() if change is not None]
    return f"Lights as at calibration, to {max(changes):.1%}." if changes else "Lights not seen yet: lift off."
