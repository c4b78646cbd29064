"""Exact solids of OpenSCAD's CSG exports, as STEP: planes and true cylinders, where an STL has many flat facets.

    python .ci/step/step_write.py PART.csg ...      # PART.step beside each

Wants Open CASCADE's Python binding (`make step` installs it in a place of its own); nothing else of Retrograph does.
Each written file is read again: its solid must be closed, valid and one, or the run ends with a sentence.
"""

import sys
from functools import reduce
from pathlib import Path
from typing import Any

import csg_tree
from OCP.BRep import BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCone, BRepPrimAPI_MakeCylinder
from OCP.gp import gp_Trsf
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_RetDone
from OCP.Message import Message, Message_Gravity
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Reader, STEPControl_Writer
from OCP.TopAbs import TopAbs_SHELL, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer


def primitive(node: csg_tree.Node) -> Any:
    """A box, cylinder or cone; however many sides OpenSCAD gives a cylinder, it is round here."""
    given: dict[str, Any] = node.arguments
    if given["center"]:
        raise ValueError(f"a centred {node.name} is not understood")
    if node.name == "cube":
        return BRepPrimAPI_MakeBox(*(float(side) for side in given["size"])).Shape()
    below, above, height = (float(given[name]) for name in ("r1", "r2", "h"))
    if below == above:
        return BRepPrimAPI_MakeCylinder(below, height).Shape()
    return BRepPrimAPI_MakeCone(below, above, height).Shape()


def moved(shape: Any, rows: list[list[float]]) -> Any:
    """By a rigid motion or a mirror; the export's six digits of a rotation are made orthogonal again."""
    motion = gp_Trsf()
    motion.SetValues(*(float(value) for row in rows[:3] for value in row))
    return BRepBuilderAPI_Transform(shape, motion, True).Shape()


def combined(operation: Any, first: Any, second: Any) -> Any:
    """What a Boolean operation makes of two shapes. Raises `ValueError` when it fails."""
    made = operation(first, second)
    if not made.IsDone():
        raise ValueError(f"{operation.__name__} of two solids failed")
    return made.Shape()


def solid(node: csg_tree.Node) -> Any:
    """The shape of a node; nothing (None) of an empty group."""
    if node.name in csg_tree.SOLIDS:
        return primitive(node)
    children = [shape for shape in map(solid, node.children) if shape is not None]
    if not children:
        return None
    if node.name == "difference":
        return reduce(lambda left, taken: combined(BRepAlgoAPI_Cut, left, taken), children)
    if node.name == "intersection":
        return reduce(lambda left, other: combined(BRepAlgoAPI_Common, left, other), children)
    joined = reduce(lambda left, other: combined(BRepAlgoAPI_Fuse, left, other), children)
    matrix: Any = node.arguments.get("")
    return moved(joined, matrix) if node.name == "multmatrix" else joined


def one_face_each(shape: Any) -> Any:
    """Faces and edges that lie in one surface or line, joined."""
    joined = ShapeUpgrade_UnifySameDomain(shape, True, True, True)
    joined.Build()
    return joined.Shape()


def parts_of(shape: Any, kind: Any) -> list[Any]:
    """All solids, or all shells, of a shape."""
    found, explorer = [], TopExp_Explorer(shape, kind)
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def volume_mm3(shape: Any) -> float:
    """Volume of a closed shape in mm³."""
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return float(properties.Mass())


def write(shape: Any, out: Path) -> None:
    """A STEP file, lengths in mm."""
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_AsIs)
    if writer.Write(str(out)) != IFSelect_RetDone:
        raise ValueError(f"{out} could not be written")


def checked_volume_mm3(step: Path) -> float:
    """Volume of the one closed, valid solid in a STEP file. Raises `ValueError` when it holds anything else."""
    reader = STEPControl_Reader()
    if reader.ReadFile(str(step)) != IFSelect_RetDone:
        raise ValueError(f"{step} cannot be read again")
    reader.TransferRoots()
    shape = reader.OneShape()
    solids = parts_of(shape, TopAbs_SOLID)
    if len(solids) != 1:
        raise ValueError(f"{step} holds {len(solids)} solids and not one")
    if not BRepCheck_Analyzer(shape).IsValid():
        raise ValueError(f"{step}: the solid is not valid")
    if not all(BRep_Tool.IsClosed_s(shell) for shell in parts_of(shape, TopAbs_SHELL)):
        raise ValueError(f"{step}: the solid is not closed")
    return volume_mm3(shape)


def convert(source: Path) -> str:
    """The STEP file beside a CSG export; its name and volume. Raises `ValueError` or `OSError`."""
    shape = solid(csg_tree.parse(source.read_text(encoding="utf-8")))
    if shape is None:
        raise ValueError(f"{source} holds no solid")
    step = source.with_suffix(".step")
    write(one_face_each(shape), step)
    return f"{step} {checked_volume_mm3(step):.2f} mm3"


def main(sources: list[str]) -> int:
    """STEP of every source; 1 and a sentence at the first that cannot be made."""
    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    for source in sources:
        try:
            print(convert(Path(source)))
        except (ValueError, OSError) as error:
            print(f"step: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
