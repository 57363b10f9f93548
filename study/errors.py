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


class IncompletePlanWarning(UserWarning):
    """A plan leaves accessible target behind; the message says how much."""


class PaddedVolumeWarning(UserWarning):
    """A margin leaves its volume, which was padded; the message says by how much."""
