"""Summary of a calibration in lines of text."""

from __future__ import annotations

from device.calibration.acceptance import Check
from host_sync.calibration.calibrate import Calibration


def calibration_lines(calibration: Calibration) -> tuple[str, ...]:
    """Return the verdict and key values; then what to press next, and notes, one sentence each."""
    assessment = calibration.assessment
    failed = [_failed(check) for check in assessment.checks if not check.passed]
    balls = sum(len(press.balls) for press in calibration.presses)
    figures = [f"{balls} balls"]
    if calibration.inverse.held_out_deg is not None:
        figures.append(f"held-out error {calibration.inverse.held_out_deg:.2f} degrees")
    share = assessment.scale.height_share
    missing = " and ".join(assessment.scale.not_measured)
    figures.append(f"height scale ± {share:.2%}" if share is not None else f"± of the height scale unknown ({missing})")
    verdict = f"did not pass: {', '.join(failed)}" if failed else "passed"
    following = assessment.coverage.next_presses() if failed else ()
    return (
        f"calibration {verdict} ({', '.join(figures)})",
        *following,
        *assessment.notes,
        *calibration.frame_model.blind,
    )


def _failed(check: Check) -> str:
    return f"{check.name} {check.words}"
