"""Numbers of the paper's method with sensor depth are those of the kept flights."""

from __future__ import annotations

from document_numbers import agree_sentence, json_of


def test_sentences_of_the_papers_method() -> None:
    kept = json_of("paper-method.json")
    between, beyond, many = ([flight["median_cm"], flight["rmse_cm"]] for flight in kept["flights"])
    sentences = {
        r"has a median of [\d.]+ cm and an RMSE of [\d.]+ cm between the build frames": between,
        r"and [\d.]+ and [\d.]+ cm beyond them": beyond,
        r"Ten times the particles, beyond, give \d+ and \d+ cm": many,
        r"falls from [\d.]+ to [\d.]+ %": [100.0 * error for error in kept["held_out_absrel"]],
        r"moved by [\d.]+ cm in the median": [kept["shift_median_cm"]],
    }
    for pattern, expected in sentences.items():
        agree_sentence("docs/beyond-the-paper.md", pattern, expected)
