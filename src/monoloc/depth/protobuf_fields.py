"""The fields of protocol-buffer messages that come from anywhere, read without a schema and within bounds.

https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

from collections.abc import Iterator

_NUMBER, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5  # kinds of fields; 3 and 4, groups, are no longer written
_MOST_DIGITS = 10  # of seven bits: a number has at most 64


class ProtobufReader:
    """Reads messages; a message in a message is read by another call, so that nothing here recurses.

    Args:
        most_fields: bound on the fields of all messages together.
    """

    def __init__(self, most_fields: int) -> None:
        self._fields_left = most_fields

    def fields(self, message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
        """Number and value of each field of a message, in its order; numbers of a fixed size are bytes.

        Raises:
            ValueError: the message is damaged, or there are more fields than the bound.
        """
        position = 0
        while position < len(message):
            self._fields_left -= 1
            if self._fields_left < 0:
                raise ValueError("it has too many parts")
            key, position = _number(message, position)
            if key >> 3 == 0:
                raise ValueError("it is damaged")
            value, position = _value(message, position, key & 7)
            yield key >> 3, value


def _value(message: memoryview, position: int, kind: int) -> tuple[int | memoryview, int]:
    """Value of a field of a kind, and the position behind it."""
    if kind == _NUMBER:
        return _number(message, position)
    if kind == _BYTES:
        length, position = _number(message, position)
    elif kind in (_EIGHT_BYTES, _FOUR_BYTES):
        length = 8 if kind == _EIGHT_BYTES else 4
    else:
        raise ValueError("it is damaged")
    end = position + length
    if end > len(message):
        raise ValueError("it is cut short")
    return message[position:end], end


def _number(message: memoryview, position: int) -> tuple[int, int]:
    """A number of variable length, and the position behind it."""
    if position < len(message) and message[position] < 0x80:  # most have one digit
        return message[position], position + 1
    number = 0
    for digit, byte in enumerate(message[position : position + _MOST_DIGITS]):
        number |= (byte & 0x7F) << 7 * digit
        if byte < 0x80:
            return number, position + digit + 1
    raise ValueError("it is cut short")
