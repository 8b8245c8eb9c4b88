"""The report as a PDF, made by ReportLab with the fonts of matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from monoloc.errors import MissingExtraError
from monoloc_lab.experiments.report_text import (
    Block,
    Heading,
    Paragraph,
    Picture,
    Table,
    Verdict,
    bound_text,
    report_title,
    spread_sentence,
    without_repeats,
)
from monoloc_lab.experiments.study import Study

_INK, _SOFT, _LINE, _YES, _NO = "#1a1a1a", "#5c5c5c", "#cccccc", "#00704f", "#a84300"
_FONTS = {"Text": "DejaVuSans.ttf", "Text-Bold": "DejaVuSans-Bold.ttf"}
_MARGIN_PT = 51.0  # 18 mm
_LARGEST = 0.44  # points per pixel, so that text in narrow pictures is no larger than the page's
_TALLEST = 0.66  # largest share of a page for a picture, so that its heading stays with it


def pdf_file(study: Study, blocks: Sequence[Block]) -> bytes:
    """The content of the PDF, in A4.

    Raises:
        MissingExtraError: ReportLab or matplotlib is not installed.
        OSError: a picture cannot be read.
    """
    try:
        import matplotlib
        from reportlab.lib.pagesizes import A4
        from reportlab.pdfbase import pdfmetrics
        from reportlab.pdfbase.ttfonts import TTFont
        from reportlab.platypus import Paragraph as Text
        from reportlab.platypus import SimpleDocTemplate
    except ImportError as error:
        raise MissingExtraError("the report as PDF", "report") from error
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    for name, file in _FONTS.items():
        pdfmetrics.registerFont(TTFont(name, str(fonts / file)))
    pdfmetrics.registerFontFamily("Text", normal="Text", bold="Text-Bold", italic="Text", boldItalic="Text-Bold")

    title = report_title(study)
    width, height = A4[0] - 2.0 * _MARGIN_PT, A4[1] - 2.0 * _MARGIN_PT
    typesetter = _Typesetter(width, height)
    story = [Text(escape(title), typesetter.style("title"))]
    for block, following in zip(blocks, [*blocks[1:], None], strict=True):
        story += typesetter.flowables(block, with_next=isinstance(following, Picture | Table))
    content = io.BytesIO()
    document = SimpleDocTemplate(
        content,
        pagesize=A4,
        leftMargin=_MARGIN_PT,
        rightMargin=_MARGIN_PT,
        topMargin=_MARGIN_PT,
        bottomMargin=_MARGIN_PT,
        title=title,
        author="monoloc",
    )

    def number(canvas: Any, _: Any) -> None:
        canvas.setFont("Text", 7.5)
        canvas.setFillColor(_SOFT)
        canvas.drawString(_MARGIN_PT, 0.55 * _MARGIN_PT, title)
        canvas.drawRightString(A4[0] - _MARGIN_PT, 0.55 * _MARGIN_PT, str(canvas.getPageNumber()))

    document.build(story, onFirstPage=number, onLaterPages=number)
    return content.getvalue()


class _Typesetter:
    """Typesetting of blocks on pages with a text area of a width and height, in points."""

    def __init__(self, width: float, height: float) -> None:
        from reportlab.lib.styles import ParagraphStyle

        self._width, self._height = width, height
        base = ParagraphStyle("text", fontName="Text", fontSize=9.2, leading=13.6, textColor=_INK, spaceAfter=6)
        small = ParagraphStyle("small", base, fontSize=7.6, leading=10.6, textColor=_SOFT)
        self._styles = {
            "text": base,
            "with next": ParagraphStyle("with next", base, keepWithNext=1),
            "small": small,
            "title": ParagraphStyle("title", base, fontName="Text-Bold", fontSize=19, leading=24, spaceAfter=10),
            "heading": ParagraphStyle(
                "heading", base, fontName="Text-Bold", fontSize=12.5, leading=16, spaceBefore=18, keepWithNext=1
            ),
            "caption": ParagraphStyle("caption", base, fontName="Text-Bold", fontSize=8, leading=11, keepWithNext=1),
            "cell": ParagraphStyle("cell", base, fontSize=7.4, leading=9.6, spaceAfter=0),
            "head": ParagraphStyle("head", small, fontName="Text-Bold", fontSize=7.4, leading=9.6, spaceAfter=0),
        }

    def style(self, name: str) -> Any:
        return self._styles[name]

    def flowables(self, block: Block, with_next: bool) -> list[Any]:
        """The flowables of a block; with ``with_next`` a paragraph stays on the page of the next block."""
        from reportlab.platypus import Paragraph as Text

        match block:
            case Heading():
                anchor = f'<a name="{block.anchor}"/>' if block.anchor else ""
                return [Text(anchor + escape(block.text), self.style("heading"))]
            case Paragraph():
                style = "small" if block.small else "with next" if with_next else "text"
                return [Text(escape(block.text), self.style(style))]
            case Verdict():
                return [self._verdict(block)]
            case Picture():
                return [self._picture(block)]
            case Table():
                return self._table(block)

    def _picture(self, block: Picture) -> Any:
        from reportlab.platypus import Image

        image = Image(str(block.path))
        scale = min(_LARGEST, self._width / image.imageWidth, _TALLEST * self._height / image.imageHeight)
        image.drawWidth, image.drawHeight = scale * image.imageWidth, scale * image.imageHeight
        image.hAlign = "LEFT"
        image.spaceAfter = 8
        return image

    def _verdict(self, block: Verdict) -> Any:
        """A claim beside a coloured bar, on one page."""
        from reportlab.platypus import Paragraph as Text
        from reportlab.platypus import Table as Grid

        claim = block.claim
        colour, mark = (_YES, "✓") if claim.holds else (_NO, "✗")
        verdict = f'<font name="Text-Bold" color="{colour}">{mark} {bound_text(claim).capitalize()}.</font>'
        inside = [
            Text(f'<font name="Text-Bold">{escape(claim.name)}</font>', self.style("text")),
            Text(f"{verdict} {escape(claim.figure)}", self.style("text")),
        ]
        if claim.analysis:
            inside.append(Text(escape(claim.analysis), self.style("text")))
        inside.append(Text(escape(spread_sentence(claim)), self.style("small")))
        style = [
            ("LINEBEFORE", (0, 0), (0, 0), 3, colour),
            ("LEFTPADDING", (0, 0), (0, 0), 10),
            ("TOPPADDING", (0, 0), (0, 0), 0),
            ("BOTTOMPADDING", (0, 0), (0, 0), 0),
        ]
        return Grid([[inside]], colWidths=[self._width], style=style, spaceBefore=4, spaceAfter=10, hAlign="LEFT")

    def _table(self, block: Table) -> list[Any]:
        from reportlab.platypus import Paragraph as Text
        from reportlab.platypus import Table as Grid

        rows = without_repeats(block.rows)
        cells = [[Text(escape(name), self.style("head")) for name in block.head]]
        cells += [[Text(escape(cell), self.style("cell")) for cell in row] for row in rows]
        style = [
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
            ("LEFTPADDING", (0, 0), (-1, -1), 0),
            ("RIGHTPADDING", (0, 0), (-1, -1), 8),
            ("TOPPADDING", (0, 0), (-1, -1), 2.2),
            ("BOTTOMPADDING", (0, 0), (-1, -1), 2.2),
            ("LINEBELOW", (0, 0), (-1, 0), 0.8, "#999999"),
            ("LINEBELOW", (0, 1), (-1, -1), 0.3, _LINE),
        ]
        grid = Grid(
            cells, colWidths=self._column_widths(block, rows), style=style, repeatRows=1, hAlign="LEFT", spaceAfter=12
        )
        return [Text(escape(block.title), self.style("caption")), grid]

    def _column_widths(self, block: Table, rows: Sequence[Sequence[str]]) -> list[float]:
        """Widths by the longest cells, reduced if they exceed the page."""
        from reportlab.pdfbase.pdfmetrics import stringWidth

        needed = [
            10.0
            + max(
                stringWidth(block.head[column], "Text-Bold", 7.4),
                max((stringWidth(row[column], "Text", 7.4) for row in rows), default=0.0),
            )
            for column in range(len(block.head))
        ]
        total = sum(needed)
        if total <= self._width:
            return needed
        # Only columns wider than an even share are reduced.
        share = self._width / len(needed)
        narrow = sum(width for width in needed if width <= share)
        wide = sum(width for width in needed if width > share)
        return [width if width <= share else width * (self._width - narrow) / wide for width in needed]
