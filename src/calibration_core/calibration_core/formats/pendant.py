"""Programs for the pendants of five makers: joint motions from stop to stop, each to rest, and a halt at every one.

Sources, for each maker: `doc/export.md`.
"""

from __future__ import annotations

import dataclasses
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

ABSENT = {f"E{i}": "9E9" for i in range(1, 7)}  # what RAPID writes for an external axis that is not there


@dataclasses.dataclass(frozen=True)
class Halt:
    """Where a program halts.

    Attributes:
        axes: Axis of the controller -> value and unit, as they are written.
        speed: Of the motion that leads here, in the maker's unit; None: its duration is open, for it begins anywhere.
        text: What is done there.
        label: The same within 24 characters.
    """

    axes: Mapping[str, tuple[str, str]]
    speed: float | None
    text: str
    label: str


@dataclasses.dataclass(frozen=True)
class Maker:
    """How a maker's controllers are programmed.

    Attributes:
        language: Of the programs.
        suffix: Of their files; in capitals: the whole name is.
        known: What names its robots.
        axes: The robot's own, in order.
        further: External ones.
        angle: Unit of a turning axis, decimals included.
        speed: How the speed of a joint motion is stated: share of the fastest axis's largest speed, duration, or speed
            of the fastest axis.
        step: Of that number.
        coupled: Its third axis is counted from the level, so that the second moves it.
        write: Returns the program of a name, with remarks at its beginning.
    """

    language: str
    suffix: str
    known: re.Pattern[str]
    axes: tuple[str, ...]
    further: tuple[str, ...]
    angle: Literal["deg", "rad", "pulses"]
    speed: Literal["%", "s", "rad/s"]
    step: float
    coupled: bool
    write: Callable[[str, Sequence[str], Sequence[Halt]], str]

    def file(self, name: str) -> str:
        """Return the name of the file that holds a program."""
        return f"{name.upper() if self.suffix.isupper() else name}{self.suffix}"


def plain(text: str) -> str:
    """Return a text in the characters that every controller's remarks may hold; others become `_`."""
    letters = "".join(one for one in unicodedata.normalize("NFKD", text) if not unicodedata.combining(one))
    return re.sub(r"[^\w .,:()/+-]", "_", letters, flags=re.ASCII)


def _kuka(name: str, remarks: Sequence[str], stops: Sequence[Halt]) -> str:
    """KRL of KSS 8: in T1, SPTP moves at the stated share of the axis speeds; PTP would be slower by machine data."""
    lines = ["&ACCESS RVP", "&REL 1", f"DEF {name} ( )", *(f"; {one}" for one in remarks)]
    lines += ["; tool 1: TOOL_DATA[1] and LOAD_DATA[1] are of what the flange carries"]
    lines += ["BAS (#INITMOV,0)", "BAS (#TOOL,1)", "BAS (#BASE,0)"]
    for stop in stops:
        axes = ", ".join(f"{axis} {value}" for axis, (value, _) in stop.axes.items())
        lines += ["WHILE $MODE_OP<>#T1", "HALT ; T1 only", "ENDWHILE", f"BAS (#VEL_PTP,{stop.speed:.0f})"]
        lines += [f"SPTP {{E6AXIS: {axes}}} WITH $VEL_AXIS[1]=SVEL_JOINT({stop.speed:.1f})", f"HALT ; {stop.text}"]
    return _lines([*lines, "END"])


def _abb(name: str, remarks: Sequence[str], stops: Sequence[Halt]) -> str:
    r"""RAPID: `\T` is the duration of a motion in s, in place of its speed: else 50 mm/s and 5 deg/s."""
    lines = [f"MODULE {name}", *(f"  ! {one}" for one in remarks)]
    lines += [
        f"  ! Start with PP to Routine, {name}_run. Enter what the flange carries: kg, centre of gravity in mm.",
        "  LOCAL PERS tooldata on_flange:=[TRUE,[[0,0,0],[1,0,0,0]],[0.001,[0,0,0.001],[1,0,0,0],0,0,0]];",
        "  LOCAL CONST speeddata slow:=[50,5,50,5];",
    ]
    run = []
    for k, stop in enumerate(stops, 1):
        own = ",".join(value for axis, (value, _) in stop.axes.items() if axis[0] == "J")
        outer = ",".join(stop.axes[axis][0] if axis in stop.axes else absent for axis, absent in ABSENT.items())
        lines.append(f"  LOCAL CONST jointtarget s{k}:=[[{own}],[{outer}]];")
        speed = "slow" if stop.speed is None else f"slow\\T:={stop.speed:.1f}"
        run += ["    only_manual;", f"    MoveAbsJ s{k}\\NoEOffs,{speed},fine,on_flange;"]
        run += [f'    TPWrite "{stop.text[:80]}";', "    Stop;"]
    lines += [f"  PROC {name}_run()", *run, "  ENDPROC", "  LOCAL PROC only_manual()"]
    lines += ["    WHILE OpMode()<>OP_MAN_PROG DO", '      TPWrite "Manual reduced speed only.";', "      Stop;"]
    return _lines([*lines, "    ENDWHILE", "  ENDPROC", "ENDMODULE"])


def _fanuc(name: str, remarks: Sequence[str], stops: Sequence[Halt]) -> str:
    body = [f"!{part}" for one in remarks for part in _cut(one, 32)] + ["UFRAME_NUM=0", "UTOOL_NUM=1"]
    positions = []
    for k, stop in enumerate(stops, 1):
        speed = "1%" if stop.speed is None else f"{stop.speed:.1f}sec"
        body += [f"J P[{k}] {speed} FINE", f"MESSAGE[{stop.label}]", "PAUSE"]
        axes = ",\t".join(f"{axis}= {value} {unit}" for axis, (value, unit) in stop.axes.items())
        positions += [f"P[{k}]{{", "   GP1:", "\tUF : 0, UT : 1,", f"\t{axes}", "};"]
    head = [f"/PROG  {name.upper()}", "/ATTR", "OWNER = MNEDITOR;", 'COMMENT = "calibration";']
    head += ["PROTECT = READ_WRITE;", "DEFAULT_GROUP = 1,*,*,*,*;", "CONTROL_CODE = 00000000 00000000;", "/MN"]
    return _lines([*head, *(f"{k:4}:  {one} ;" for k, one in enumerate(body, 1)), "/POS", *positions, "/END"])


def _yaskawa(name: str, remarks: Sequence[str], stops: Sequence[Halt]) -> str:
    """INFORM: jobs hold joint angles as pulses of the encoders; `'` begins a remark of at most 32 characters."""
    lines = ["/JOB", f"//NAME {name.upper()}", "//POS", f"///NPOS {len(stops)},0,0,0,0,0", "///TOOL 0"]
    lines += ["///POSTYPE PULSE", "///PULSE"]
    lines += [f"C{k:05}={','.join(value for value, _ in stop.axes.values())}" for k, stop in enumerate(stops)]
    lines += ["//INST", "///DATE 2000/01/01 00:00", "///COMM calibration", "///ATTR SC,RW", "///GROUP1 RB1", "NOP"]
    lines += [f"'{part}" for one in remarks for part in _cut(one, 32)]
    for k, stop in enumerate(stops):
        lines += [f"MOVJ C{k:05} VJ={stop.speed:.2f} PL=0", f"'{stop.label}", "PAUSE"]
    return _lines([*lines, "END"])


def _ur(name: str, remarks: Sequence[str], stops: Sequence[Halt]) -> str:
    lines = [*(f"# {one}" for one in remarks), f"def {name}():"]
    for stop in stops:
        q = ", ".join(value for value, _ in stop.axes.values())
        lines.append(f"  movej([{q}], a=0.5, v={stop.speed:.4f})")
        lines.append(f'  popup("{stop.text}", title="calibration", blocking=True)')
    return _lines([*lines, "end", f"{name}()"], end="\n")


def _lines(lines: Sequence[str], end: str = "\r\n") -> str:
    return end.join([*lines, ""])


def _cut(text: str, most: int) -> list[str]:
    """Return a text in parts of at most so many characters, broken at blanks where there are some."""
    return re.findall(rf"\S.{{0,{most - 2}}}\S(?=\s|$)|\S{{1,{most}}}", text)


_SIX = ("J1", "J2", "J3", "J4", "J5", "J6")
_OUTER = tuple(ABSENT)
MAKERS: Mapping[str, Maker] = {
    "kuka": Maker(
        "KUKA KRL", ".src", re.compile(r"\bkuka\b", re.IGNORECASE), ("A1", "A2", "A3", "A4", "A5", "A6"), _OUTER,
        "deg", "%", 1.0, False, _kuka,
    ),
    "abb": Maker(
        "ABB RAPID", ".mod", re.compile(r"\babb\b", re.IGNORECASE), _SIX, _OUTER, "deg", "s", 0.1, False, _abb
    ),
    "fanuc": Maker(
        "FANUC TP", ".ls", re.compile(r"\bfanuc\b", re.IGNORECASE), _SIX, _OUTER[:3], "deg", "s", 0.1, True, _fanuc
    ),
    "yaskawa": Maker(
        "Yaskawa INFORM", ".JBI", re.compile(r"\b(yaskawa|motoman)\b", re.IGNORECASE), ("S", "L", "U", "R", "B", "T"),
        (), "pulses", "%", 0.01, False, _yaskawa,
    ),
    "ur": Maker(
        "Universal Robots script", ".script", re.compile(r"\buniversal robots\b|\bur\d", re.IGNORECASE), _SIX, (),
        "rad", "rad/s", 1e-4, False, _ur,
    ),
}  # fmt: skip
