"""The three kinds of file that owners give: a print, one that motors cannot follow, and none.

A print is the sample cube as CuraEngine sliced it, cut to its first layers.
"""

from itertools import takewhile

from tests.conftest import SAMPLES

SMALL = 2  # layers
END = b"M140 S0\n"  # begins what CuraEngine writes last
STL = b"""\
solid cube
  facet normal 0 0 -1
    outer loop
      vertex 0 0 0
      vertex 20 20 0
      vertex 20 0 0
    endloop
  endfacet
endsolid cube
"""


def sliced(layers: int) -> bytes:
    """Return the cube's first layers and the end of its file, for a bed of 200 mm."""
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)
    head = takewhile(lambda line: line.strip() != b";LAYER:%d" % layers, lines)
    end = lines[lines.index(END) :]
    return b"".join([*head, *end]).replace(b"G1 X0 Y220", b"G1 X0 Y190")


def too_fast(layers: int, edge: float | None) -> bytes:
    """Return a print that ends with infill at full acceleration, and beyond the bed.

    edge: of the bed, x in mm. Without one the infill alone is too fast, for motors whose owner has
    lowered their limits.
    """
    whole = sliced(layers)
    end = whole.index(END)
    strokes = ["M204 S50000", "M204 P50000 T50000", "M201 X50000 Y50000"]
    strokes += [f"G1 X{80 + 40 * (k % 2)} Y{80 + k} E1.5 F30000" for k in range(40)]
    strokes += [f"G1 X{edge + 20:g} F3000", "G1 X100", ""] if edge is not None else [""]
    return whole[:end] + "\n".join(strokes).encode() + whole[end:]
