"""What is in force: the mounted gel, its calibration with its scanner, and the health that is watched under it."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

from device.bundle_store import BundleStore
from device.calibration_shelf import CalibrationShelf
from device.coaching.coach import CoachModel
from device.errors import DeviceError
from device.gel_log import known_gel, make_gel, mount_gel
from device.health_limits import FLAT_RESIDUAL_UM
from device.scanning.capture import CapturePlan
from device.scanning.mounting import with_mounted_gel
from device.scanning.scan_health import ZeroCheck
from device.scanning.scanner import Scanner
from device.session.cues import show
from device.session.described import Choice, calibration_age_s, calibration_state, choice_of, gel_state
from device.session.events import Failed, Told, ZeroChecked
from device.session.health_report import health_state, zero_sentence
from device.session.live_loop import LiveFrame, LiveLoop
from device.session.noticeboard import Noticeboard
from device.session.rest_looks import RestLooks
from device.session.state import CalibrationState, HealthState
from hal.errors import HalError
from hal.hardware import Hardware


class InForce:
    """The scanner that presses go through, or the reason why there is none."""

    def __init__(
        self, hardware: Hardware, store: BundleStore, board: Noticeboard, live: LiveLoop, executor: Executor
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._board = board
        self._live = live
        self._executor = executor
        self._scanner: Scanner | None = None
        self._fault: DeviceError | HalError | None = None
        self._looks: RestLooks | None = None
        self._zero: ZeroCheck | None = None
        self._choice: Choice | None = None

    def fitted(self) -> Hardware:
        """The hardware with the gel that is mounted. Errors as for `with_mounted_gel`."""
        return with_mounted_gel(self._hardware, self._store.root)

    def scanner(self) -> Scanner:
        """The scanner in force.

        Raises
        ------
        DeviceError, HalError
            Why there is none.
        """
        if self._scanner is None:
            raise self._fault or DeviceError("the instrument is not ready yet: wait a moment")
        return self._scanner

    def scans_left(self) -> int | None:
        """How many more scans fit; None when that cannot be told."""
        try:
            return self.scanner().scans_left()
        except (DeviceError, HalError):
            return None

    def scanner_for_press(self) -> Scanner:
        """The scanner of a press that begins now, whatever another program chose meanwhile. Errors as for `scanner`."""
        self.follow()
        return self.scanner()

    def follow(self) -> None:
        """Put in force what another program, such as `retroscan gel`, has mounted or activated in this store."""
        if self._choice is None or self._choice == choice_of(self._store, self._hardware):
            return
        self.prepare()
        state = self._board.state
        told = f"Changed by another program: calibration {state.calibration.calibration_id}, gel {state.gel.gel_id}."
        self._board.tell(Failed(state.calibration.fault) if state.calibration.fault else Told(told))

    def report_age(self) -> None:
        """Bring the age of the calibration in force up to date."""
        if self._scanner:
            age_s = calibration_age_s(self._scanner.calibration, self._store)
            self._board.change(calibration=replace(self._board.state.calibration, age_s=age_s))

    def prepare(self) -> None:
        """Put the store's active calibration in force for the mounted gel, or say why there is none."""
        self._scanner = self._looks = self._zero = None
        self._choice = choice_of(self._store, self._hardware)
        self._board.change(gel=gel_state(self._store.root, self._hardware))
        try:
            fitted = self.fitted()
            scanner = Scanner(fitted, self._store)
            state = calibration_state(scanner.calibration, CalibrationShelf(self._store, fitted.profile), self._store)
        except (DeviceError, HalError) as error:
            self._fault = error
            self._live.begin(CapturePlan.of_board(self._hardware), None)
            unseen = HealthState(dict.fromkeys(self._hardware.profile.currents_ma))
            self._board.change(calibration=CalibrationState(fault=str(error)), health=unseen)
            return
        self._scanner, self._fault = scanner, None
        self._looks = RestLooks(scanner.health, self._executor)
        self._live.begin(scanner.plan, _coach_model(scanner, fitted.profile.gel.slab_thickness_mm))
        self._board.change(calibration=state)
        self.report_health()

    def look(self, live: LiveFrame) -> None:
        """See to untouched skin when it is time."""
        if self._looks and self._looks.step(live):
            self.report_health()

    def want_look(self) -> None:
        """A press was taken: untouched skin is worth a look after it."""
        if self._looks:
            self._looks.want()

    def report_health(self) -> None:
        """Bring the state's health and gel up to date."""
        if self._scanner is None:
            return
        health = self._scanner.health
        red, green, blue = (1.0 + (change or 0.0) for change in health.light_change.values())
        self._live.expect((red, green, blue))
        gel = gel_state(self._store.root, self._hardware)
        self._board.change(gel=gel, health=health_state(health, gel, self._zero))

    def check_zero(self) -> None:
        """Take a frame of the untouched skin and say how flat it reads."""
        try:
            scanner = self.scanner()
            zero = scanner.health.check_zero(scanner.take().shot.frame)
        except (DeviceError, HalError) as error:
            self._fail(f"zero check: {error}")
            return
        self._zero = zero
        self.report_health()
        sentence, passed = zero_sentence(zero), zero.flat_residual_um <= FLAT_RESIDUAL_UM
        self._board.change(sentence=sentence)
        self._board.tell(ZeroChecked(zero.flat_residual_um, passed, sentence))
        show(self._hardware, "good" if passed else "doubtful")

    def change_gel(self, gel_id: str, slab_thickness_mm: float | None) -> None:
        """Another gel was mounted: its calibration comes into force, or scans are refused by name.

        slab_thickness_mm : of a gel that was never mounted; the board's own when None
        """
        usual = self._hardware.profile.gel
        try:
            self._shelf()  # what is in force now is remembered for the gel that goes
            known = known_gel(self._store.root, gel_id) if slab_thickness_mm is None else None
            mount_gel(self._store.root, known or make_gel(gel_id, slab_thickness_mm or usual.slab_thickness_mm))
            entry = self._shelf().switch()
        except DeviceError as error:
            self.prepare()
            self._fail(str(error))
            return
        self.prepare()
        self._board.tell(Told(f"Gel {gel_id} is mounted; calibration {entry.calibration_id} is in force."))

    def roll_back(self) -> None:
        """Put the calibration before this one in force."""
        try:
            entry = self._shelf().roll_back()
        except DeviceError as error:
            self._fail(str(error))
            return
        self.prepare()
        self._board.tell(Told(f"Back to version {entry.version}: calibration {entry.calibration_id} is in force."))

    def put_in_force(self, calibration_id: str) -> None:
        """Put a calibration of the shelf in force."""
        try:
            self._shelf().put_in_force(calibration_id)
        except DeviceError as error:
            self._fail(str(error))
            return
        self.prepare()
        self._board.tell(Told(f"Calibration {calibration_id} is in force."))

    def _shelf(self) -> CalibrationShelf:
        shelf = CalibrationShelf(self._store, self.fitted().profile)
        shelf.entry_in_force()
        return shelf

    def _fail(self, sentence: str) -> None:
        self._board.change(sentence=sentence)
        self._board.tell(Failed(sentence))
        show(self._hardware, "refused: calibration")


def _coach_model(scanner: Scanner, slab_thickness_mm: float) -> CoachModel:
    calibration = scanner.calibration
    pitch_um = calibration.record.pixel_pitch_um
    return CoachModel.prepare(calibration.reference(), scanner.model.slopes, pitch_um, 1e3 * slab_thickness_mm)
