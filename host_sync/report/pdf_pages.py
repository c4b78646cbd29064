"""A report as PDF pages (A4) in matplotlib's font, which covers µ, ±, × and most scripts.

Why reportlab: it breaks tables and pictures over pages, is one wheel for all machines, and has a BSD licence.
"""

from __future__ import annotations

import io
from html import escape
from pathlib import Path
from typing import Any, Final

import matplotlib
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import (
    Flowable,
    Image,
    KeepTogether,
    LongTable,
    Paragraph,
    SimpleDocTemplate,
    Spacer,
    TableStyle,
)

from host_sync.report.content import SIGNED, VERDICT_HEAD, Picture, Report, Table
from host_sync.text import printable

WIDTH: Final = A4[0] - 30.0 * mm - 12.0
"""Width between the margins and their padding of six points."""
MAX_HEIGHT: Final = 120.0 * mm
_FACES: Final = {"Report": "DejaVuSans.ttf", "Report-Bold": "DejaVuSans-Bold.ttf", "Report-Mono": "DejaVuSansMono.ttf"}
_SHARES: Final = {2: (0.34, 0.66), 3: (0.20, 0.26, 0.54), 4: (0.18, 0.24, 0.20, 0.38)}
_HASH_SHARES: Final = (0.30, 0.13, 0.57)

_BODY: Final = ParagraphStyle("body", fontName="Report", fontSize=8.5, leading=11.5, wordWrap="CJK")
_SMALL: Final = ParagraphStyle("small", parent=_BODY, fontSize=7.5, leading=10.0)
_MONO: Final = ParagraphStyle("mono", parent=_BODY, fontName="Report-Mono", fontSize=5.6, leading=8.0)
_GREY: Final = ParagraphStyle("grey", parent=_SMALL, textColor=colors.HexColor("#555555"))
_TITLE: Final = ParagraphStyle("title", parent=_BODY, fontName="Report-Bold", fontSize=15, leading=19)
_HEAD: Final = ParagraphStyle("head", parent=_BODY, fontName="Report-Bold", fontSize=10, leading=14, spaceBefore=8)
_WARNING: Final = ParagraphStyle("warning", parent=_BODY, textColor=colors.HexColor("#b03020"))

_VERDICTS: Final = {
    name: ParagraphStyle(name, parent=_SMALL, fontName="Report-Bold", textColor=colors.HexColor(colour))
    for name, colour in (("pass", "#1d5d33"), ("fail", "#8c2f1b"), ("undecided", "#7a4a00"))
}


def pdf_pages(report: Report) -> bytes:
    """The bytes of the PDF; the same report gives the same bytes."""
    for name, file in _FACES.items():
        if name not in pdfmetrics.getRegisteredFontNames():
            pdfmetrics.registerFont(TTFont(name, str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / file)))
    stream = io.BytesIO()
    document = SimpleDocTemplate(
        stream,
        pagesize=A4,
        leftMargin=15.0 * mm,
        rightMargin=15.0 * mm,
        topMargin=14.0 * mm,
        bottomMargin=16.0 * mm,
        title=report.title,
        creator="Retrograph",
        invariant=1,
    )
    document.build(_story(report), onFirstPage=_foot(report), onLaterPages=_foot(report))
    return stream.getvalue()


def _story(report: Report) -> list[Flowable]:
    story: list[Flowable] = [*_organisation(report), _words(report.title, _TITLE), _words(report.operations, _GREY)]
    story += [_words(f"Warning: {warning}", _WARNING) for warning in report.warnings]
    if report.verdict:
        story.append(_words(f"Tolerances: {report.verdict}", _VERDICTS[report.verdict]))
    story += [Spacer(0, 2.0 * mm), _grid([[_words(a, _GREY), _words(b, _BODY)] for a, b in report.facts], (0.24, 0.76))]
    story += [_figure(picture) for picture in report.pictures[:1]]
    for table in report.tables:
        story += _table(table)
    story += [Spacer(0, 2.0 * mm), *(_words(f"– {note}", _SMALL) for note in report.notes)]
    story += [_figure(picture) for picture in report.pictures[1:]]
    for table in report.appendix:
        story += _table(table, _HASH_SHARES, _MONO) if len(table.head) == len(_HASH_SHARES) else _table(table)
    return [*story, Spacer(0, 3.0 * mm), _words(f"{SIGNED}: {report.signature}", _MONO)]


def _organisation(report: Report) -> list[Flowable]:
    """Logo and organisation side by side."""
    if report.logo is None and not report.head:
        return []
    words: list[Flowable] = [_words(line, _BODY) for line in report.head]
    cells: list[Any] = [words]
    shares = [1.0]
    if report.logo is not None:
        columns, rows = report.logo.size
        scale = min(50.0 * mm / columns, 18.0 * mm / rows)
        cells.insert(0, Image(io.BytesIO(report.logo.png), columns * scale, rows * scale))
        shares = [0.32, 0.68]
    line: Any = [cells]
    return [
        LongTable(line, [share * WIDTH for share in shares], style=TableStyle([("VALIGN", (0, 0), (-1, -1), "MIDDLE")]))
    ]


def _words(text: str, style: ParagraphStyle) -> Paragraph:
    """A paragraph with markup escaped."""
    return Paragraph(escape(printable(text), quote=False), style)


def _table(table: Table, shares: tuple[float, ...] | None = None, style: ParagraphStyle = _SMALL) -> list[Flowable]:
    head = [[_words(cell, _GREY) for cell in table.head]]
    rows = [
        [_words(cell, _of_cell(*pair, style)) for pair in zip(table.head, row, strict=True) for cell in pair[1:]]
        for row in table.rows
    ]
    grid = _grid(head + rows, shares or table.widths or _SHARES[len(table.head)], repeated=1)
    return [_words(table.title, _HEAD), grid, *(_words(remark, _SMALL) for remark in table.remarks)]


def _of_cell(head: str, cell: str, style: ParagraphStyle) -> ParagraphStyle:
    return _VERDICTS.get(cell.partition(":")[0], style) if head == VERDICT_HEAD else style


def _grid(rows: list[list[Paragraph]], shares: tuple[float, ...], repeated: int = 0) -> LongTable:
    lines: list[Any] = [
        ("LINEBELOW", (0, 0), (-1, -1), 0.3, colors.HexColor("#dddddd")),
        ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ("TOPPADDING", (0, 0), (-1, -1), 1.2),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 1.8),
        ("LEFTPADDING", (0, 0), (-1, -1), 0.0),
    ]
    return LongTable(rows, [share * WIDTH for share in shares], repeatRows=repeated, style=TableStyle(lines))


def _figure(picture: Picture) -> Flowable:
    columns, rows = picture.size
    scale = min(WIDTH / columns, MAX_HEIGHT / rows)
    image = Image(io.BytesIO(picture.png), columns * scale, rows * scale)
    return KeepTogether([Spacer(0, 3.0 * mm), image, _words(picture.caption, _GREY)])


def _foot(report: Report) -> Any:
    """Draw the page footer: the template's, else the beginning of the title, and the page number."""
    words = report.footer or report.title

    def draw(canvas: Any, document: Any) -> None:
        canvas.setFont("Report", 7)
        canvas.setFillColor(colors.HexColor("#555555"))
        canvas.drawString(15.0 * mm, 9.0 * mm, printable(words)[:110])
        canvas.drawRightString(A4[0] - 15.0 * mm, 9.0 * mm, f"page {document.page}")

    return draw
