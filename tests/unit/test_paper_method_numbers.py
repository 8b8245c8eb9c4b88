"""Numbers of the paper's method with sensor depth are those of the kept flights."""

from __future__ import annotations

from document_numbers import agree_sentence, json_of


def test_sentences_of_the_papers_method() -> None:
    kept = json_of("paper-method.json")
    between, beyond, many = ([flight["median_cm"], flight["rmse_cm"]] for flight in kept["flights"])
    sentences = {
        "has a median error of {} cm and an RMSE of {} cm between the build frames": between,
        "Beyond them, these are {} and {} cm": beyond,
        "ten times the particles, beyond the build frames, it has {} and {} cm": many,
        "the error falls from {} to {} %": [100.0 * error for error in kept["held_out_absrel"]],
        "moved by {} cm in the median": [kept["shift_median_cm"]],
    }
    for sentence, expected in sentences.items():
        agree_sentence("docs/beyond-the-paper.md", sentence, expected)
