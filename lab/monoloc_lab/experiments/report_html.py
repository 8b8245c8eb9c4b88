"""The report as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

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

_STYLE = """
:root { color-scheme: light; --ink: #1a1a1a; --soft: #5c5c5c; --line: #dedede; --yes: #00704f; --no: #a84300; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff; line-height: 1.55;
  font: 17px/1.55 "Source Sans 3", "Segoe UI", system-ui, -apple-system, Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.2rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .6rem; letter-spacing: -.01em; }
h2 { font-size: 1.35rem; line-height: 1.25; margin: 3.2rem 0 .6rem; padding-top: 1.1rem;
  border-top: 1px solid var(--line); }
p { max-width: 44rem; margin: .6rem 0; }
nav { font-size: .92rem; margin: 1.2rem 0 0; max-width: 44rem; color: var(--soft); }
nav a { color: #0b5a8a; text-decoration: none; margin-right: .9rem; white-space: nowrap; display: inline-block; }
nav a:hover { text-decoration: underline; }
.small { font-size: .88rem; color: var(--soft); }
.claim { max-width: 44rem; margin: 1.2rem 0; padding: .1rem 0 .1rem 1rem; border-left: 4px solid var(--no); }
.claim.holds { border-color: var(--yes); }
.claim h3 { font-size: 1.05rem; margin: 0 0 .2rem; }
.claim p { margin: .25rem 0; }
.verdict { font-weight: 600; color: var(--no); }
.holds .verdict { color: var(--yes); }
.scroll { overflow-x: auto; margin: 1.2rem 0; -webkit-overflow-scrolling: touch; }
.scroll img { display: block; width: 100%; min-width: 38rem; height: auto; }
figure { margin: 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .4rem; }
th, td { text-align: left; padding: .28rem 1.1rem .28rem 0; vertical-align: top; white-space: nowrap; }
td.long { white-space: normal; max-width: 34rem; }
th { font-weight: 600; color: var(--soft); border-bottom: 1.5px solid #999; }
td { border-bottom: 1px solid #eee; }
@media (max-width: 40rem) { body { font-size: 16px; } h1 { font-size: 1.6rem; } main { padding-top: 1.2rem; } }
@media print {
  body { font-size: 10pt; } main { max-width: none; padding: 0; } nav { display: none; }
  h2 { break-after: avoid; } figure, .claim, tr { break-inside: avoid; }
  .scroll { overflow: visible; } .scroll img { min-width: 0; }
}
"""
_LONG = 48  # longer cells are broken into lines


def html_page(study: Study, blocks: Sequence[Block]) -> str:
    """The page, with its pictures embedded.

    Raises:
        OSError: a picture cannot be read.
    """
    title = escape(report_title(study))
    links = "".join(
        f'<a href="#{escape(block.anchor)}">{escape(block.text)}</a>'
        for block in blocks
        if isinstance(block, Heading) and block.anchor
    )
    first, *rest = blocks
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n"
        + "\n".join([_block(first), f"<nav>{links}</nav>", *map(_block, rest)])
        + "\n</main>\n</body>\n</html>\n"
    )


def _block(block: Block) -> str:
    match block:
        case Heading():
            anchor = f' id="{escape(block.anchor)}"' if block.anchor else ""
            return f"<h2{anchor}>{escape(block.text)}</h2>"
        case Paragraph():
            return f"<p{' class=small' if block.small else ''}>{escape(block.text)}</p>"
        case Verdict():
            return _verdict(block)
        case Picture():
            content = base64.b64encode(block.path.read_bytes()).decode("ascii")
            image = f'<img src="data:image/png;base64,{content}" alt="{escape(block.caption)}">'
            return f'<figure><div class="scroll">{image}</div></figure>'
        case Table():
            return _table(block)


def _verdict(block: Verdict) -> str:
    claim = block.claim
    analysis = f"<p>{escape(claim.analysis)}</p>" if claim.analysis else ""
    mark = "✓" if claim.holds else "✗"
    return (
        f'<div class="claim{" holds" if claim.holds else ""}"><h3>{escape(claim.name)}</h3>'
        f'<p><span class="verdict">{mark} {bound_text(claim).capitalize()}.</span> {escape(claim.figure)}</p>'
        f'{analysis}<p class="small">{escape(spread_sentence(claim))}</p></div>'
    )


def _table(block: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in block.head)
    rows = []
    for row in without_repeats(block.rows):
        cells = "".join(f"<td{' class=long' if len(cell) > _LONG else ''}>{escape(cell)}</td>" for cell in row)
        rows.append(f"<tr>{cells}</tr>")
    return (
        f'<div class="scroll"><table><caption>{escape(block.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )
