"""The typed errors of the package: one root, a few kinds, each naming what was expected and what came."""


class StudyError(Exception):
    """Root of every error this package raises on purpose."""


class InputError(StudyError, ValueError):
    """An argument has the wrong shape, range or meaning."""


class FileFormatError(StudyError, ValueError):
    """A file is not what its suffix or header says; the message names the file."""


class GeometryError(InputError):
    """A volume's affine, spacing or extent cannot be used."""


class LabelError(InputError, KeyError):
    """A label or structure that is asked for is not in the volume."""

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return str(self.args[0]) if self.args else ""


class PlanningError(StudyError, RuntimeError):
    """No plan can be made for this volume and drill."""


class TargetUnreachableError(PlanningError):
    """No burr position inside the target can be reached from outside."""


class MarginError(StudyError, RuntimeError):
    """No margin with an acceptable risk can be grown."""


class PlanViolation(StudyError, RuntimeError):  # noqa: N818 - the violation is what the name says
    """A replayed plan cuts protected bone or drives the shaft into bone."""


class ReachError(InputError):
    """A pose that an arm cannot take."""


class CorrespondenceError(InputError):
    """Fiducials that do not correspond as given.

    Attributes
    ----------
    order : tuple of int or None
        The order of the second list in which they do; None when there is none.
    """

    def __init__(self, message: str, order: tuple[int, ...] | None = None) -> None:
        super().__init__(message)
        self.order = order


class CalibrationError(InputError):
    """Measurements from which what is to be calibrated cannot be told."""


class GuidanceError(StudyError, RuntimeError):
    """A guided robot that was asked for something its state does not allow."""


class RetractionViolation(StudyError, RuntimeError):  # noqa: N818 - the violation is what the name says
    """A retraction leaves the tube of the way in, or is faster than it may be."""


class ViewerError(StudyError, RuntimeError):
    """A live viewer cannot be served: its port is in use, or an optional package is missing."""


class IncompletePlanWarning(UserWarning):
    """A plan leaves accessible target behind; the message says how much."""


class PaddedVolumeWarning(UserWarning):
    """A margin leaves its volume, which was padded; the message says by how much."""
