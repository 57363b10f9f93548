"""How kernels are compiled: recompiled when what they call changes, records handed on by their address."""

import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

from study import _compiled
from study._compiled import inner, kernel, kernel_digest, kernel_sources
from study._records import by_address
from study.paths import PROJECT

# What is kept, and when it is compiled again

ROOMS = {
    "bones": "from {name}.tools._kernels import half\n",
    "tools": "from {name}._shared import ANGLE\n",
    "margins": "import numpy as np\nfrom {name}.bones import _kernels as bones\n",
    "robots": "import {name}.margins._kernels\n",
}


@pytest.fixture
def package(tmp_path):
    """Rooms that import each other: robots, margins, bones, tools, then a plain module."""
    folder = tmp_path / "rooms"
    for room, imports in ROOMS.items():
        (folder / room).mkdir(parents=True)
        (folder / room / "__init__.py").write_text("")
        (folder / room / "_kernels.py").write_text(imports.format(name="rooms"))
    (folder / "__init__.py").write_text("")
    (folder / "_shared.py").write_text("ANGLE = 1\n")
    return folder


@pytest.mark.parametrize(
    ("edited", "stay"),
    [
        ("robots/_kernels.py", {"bones", "tools", "margins"}),
        ("margins/_kernels.py", {"bones", "tools"}),
        ("tools/_kernels.py", set()),
        ("_shared.py", set()),
        ("bones/other.py", set(ROOMS)),
    ],
)
def test_a_change_recompiles_the_rooms_that_it_can_reach(package, edited, stay):
    def digests():
        return {room: kernel_digest(package / room / "_kernels.py", package) for room in ROOMS}

    before = digests()
    assert len(set(before.values())) == len(ROOMS)
    with open(package / edited, "a") as file:
        file.write("# another line\n")
    after = digests()
    assert {room for room in ROOMS if after[room] == before[room]} == stay


def test_a_file_that_is_no_room_may_call_any_kernel(package, tmp_path):
    (tmp_path / "bench.py").write_text("import numpy\n")
    sources = kernel_sources(tmp_path / "bench.py", package)
    assert sources >= {package / room / "_kernels.py" for room in ROOMS}


def test_planner_is_recompiled_for_the_checks_it_calls():
    room = _compiled.PACKAGE / "planners" / "strategies" / "_kernels.py"
    sources = {str(file.relative_to(_compiled.PACKAGE)) for file in kernel_sources(room)}
    assert sources >= {
        "_compiled.py",
        "_records.py",
        "collision/_kernels.py",
        "collision/exact/_kernels.py",
        "collision/directions/single/_kernels.py",
        "planners/pointing/_kernels.py",
        "planners/tilting/_kernels.py",
    }
    assert not {name for name in sources if name.startswith("robots")}


CALLER = """
from study._compiled import kernel
from rooms.bones._kernels import answer

@kernel
def ask():
    return answer()
"""
ASK = """
import sys
from pathlib import Path
from study import _compiled
_compiled.PACKAGE = Path("rooms").resolve()
from rooms.robots._kernels import ask
print(ask(), sum(ask.stats.cache_hits.values()), Path(ask.stats.cache_path).is_relative_to("kept"))
"""


def test_changed_callee_in_another_file_is_not_answered_from_the_cache(package, tmp_path):
    def ask(number):
        callee = f"from study._compiled import inner\n@inner\ndef answer():\n    return {number}\n"
        (package / "bones" / "_kernels.py").write_text(callee)
        environment = {"PYTHONPATH": f"{PROJECT}:{tmp_path}", "NUMBA_CACHE_DIR": "kept"}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # a .pyc of the same second and size would pass for new
        done = subprocess.run(
            [sys.executable, "-c", ASK], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    (package / "robots" / "_kernels.py").write_text(CALLER)
    assert ask(1) == ["1", "0", "True"]
    assert ask(1) == ["1", "1", "True"]
    assert ask(2) == ["2", "0", "True"]


# Records


@by_address
class Inside(NamedTuple):
    counts: np.ndarray
    factor: float


@by_address
class State(NamedTuple):
    field: np.ndarray
    flag: bool
    inside: Inside
    number: int


@inner
def _add(inside, n):
    inside.counts[n] += 1
    return inside.factor * n


@kernel
def _total(state):
    total = 0.0
    for n in range(state.number):
        total += _add(state.inside, n)
    for i in range(state.field.shape[0]):
        row = state.field[i]
        for j in range(row.size):
            total += row[j] if state.flag else -row[j]
    return total


def make(field, flag=True):
    return State(field, flag, Inside(np.zeros(5, np.int32), 2.0), 4)


@pytest.mark.parametrize("flag", [True, False])
@pytest.mark.parametrize("order", ["C", "F", "strided"])
def test_kernels_read_all_of_a_record(order, flag):
    field = np.arange(12.0).reshape(3, 4)
    field = {"C": field, "F": np.asfortranarray(field), "strided": np.repeat(field, 2, axis=1)[:, ::2]}[order]
    state = make(field, flag)
    assert _total(state) == 2.0 * 6 + (66.0 if flag else -66.0)
    assert state.inside.counts.tolist() == [1, 1, 1, 1, 0]  # the caller's own array


def test_kernels_leave_the_caller_its_arrays():
    state = make(np.ones((3, 4)))
    before = [sys.getrefcount(array) for array in (state.field, state.inside.counts)]
    for _ in range(10):
        _total(state)
    assert [sys.getrefcount(array) for array in (state.field, state.inside.counts)] == before


def test_a_field_of_another_type_is_another_record():
    assert _total(make(np.ones((3, 4)))) == _total(make(np.ones((3, 4), np.float32))) == 24.0
    assert len({signature[0] for signature in _total.signatures}) == len(_total.signatures) > 1


def test_fields_of_a_record_can_be_neither_set_nor_made_up():
    @kernel
    def unknown(state):
        return state.colour

    @kernel
    def set_number(state):
        state.number = 3

    with pytest.raises(TypingError, match="colour"):
        unknown(make(np.ones((1, 1))))
    with pytest.raises(NotImplementedError, match="number"):
        set_number(make(np.ones((1, 1))))


def test_something_else_in_a_record_is_an_error():
    with pytest.raises(TypingError):
        _total(State(object(), True, Inside(np.zeros(5, np.int32), 2.0), 4))


def test_kernels_of_a_test_are_kept_apart():
    assert Path(_total.stats.cache_path).parent.name.startswith("kernels-others-")
