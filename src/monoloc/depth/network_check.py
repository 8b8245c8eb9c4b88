"""What an ONNX network may hold, checked before it is loaded: it comes from anywhere, as does a bundle that holds it.

A network is a program. onnxruntime would read the files that it names, and run its loops to their end.
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
"""

from __future__ import annotations

from pathlib import Path

from monoloc.depth.onnx_operators import OPERATORS
from monoloc.depth.protobuf_fields import ProtobufReader
from monoloc.errors import DataError

MOST_NETWORK_BYTES = 1 << 28
"""Size of an ONNX file that is loaded."""

_MOST_NODES = 10_000
_MOST_FIELDS = 2_000_000
_MOST_DEPTH = 4  # of branches in branches: PyTorch writes one for torch.squeeze

_GRAPH, _TRAINING, _FUNCTIONS = 7, 20, 25  # of a model
_NODE, _INITIALIZER, _SPARSE_INITIALIZER = 1, 5, 15  # of a graph
_OPERATOR, _ATTRIBUTE, _DOMAIN = 4, 5, 7  # of a node
_TENSOR, _TENSORS, _SUBGRAPH, _SUBGRAPHS, _SPARSE_TENSORS = 5, 10, 6, 11, (22, 23)  # of an attribute
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14  # of a tensor

_DAMAGED_FIX = "give one self-contained ONNX file, such as monoloc depth export writes"
_STANDARD_FIX = "export it with standard operators (docs/how-to/another-depth-network.md)"


def check_network(content: bytes, label: str | Path, kind: type[DataError] = DataError) -> None:
    """Refuse a network that is no ONNX file, or that could read other files or never end.

    Args:
        content: the ONNX file.
        label: name of the network in error messages.
        kind: class of the error.

    Raises:
        DataError: of that kind.
    """
    try:
        _Check().model(memoryview(content))
    except _RefusedError as refused:
        raise kind(label, refused.problem, refused.fix) from refused
    except ValueError as error:
        raise kind(label, f"cannot be loaded ({error})", _DAMAGED_FIX) from error


class _RefusedError(Exception):
    def __init__(self, problem: str, fix: str) -> None:
        self.problem, self.fix = problem, fix
        super().__init__(problem, fix)


class _Check:
    """Walks through one model."""

    def __init__(self) -> None:
        self._fields = ProtobufReader(_MOST_FIELDS).fields
        self._nodes_left = _MOST_NODES

    def model(self, message: memoryview) -> None:
        if len(message) > MOST_NETWORK_BYTES:
            raise ValueError(f"it is larger than {MOST_NETWORK_BYTES >> 20} MB")
        is_model = False
        for number, value in self._fields(message):
            if number == _GRAPH:
                is_model = True
                self._graph(_message(value), _MOST_DEPTH)
            elif number == _FUNCTIONS:
                raise _RefusedError("defines operators of its own", "export it with its functions inlined")
            elif number == _TRAINING:
                raise _RefusedError("holds graphs for its training", "export it for inference")
        if not is_model:
            raise ValueError("it is no ONNX network")

    def _graph(self, message: memoryview, depth_left: int) -> None:
        for number, value in self._fields(message):
            if number == _NODE:
                self._node(_message(value), depth_left)
            elif number == _INITIALIZER:
                self._tensor(_message(value))
            elif number == _SPARSE_INITIALIZER:
                raise _RefusedError("has sparse weights", "export it with dense weights")

    def _node(self, message: memoryview, depth_left: int) -> None:
        self._nodes_left -= 1
        if self._nodes_left < 0:
            raise ValueError(f"it has more than {_MOST_NODES} operators")
        names = {_OPERATOR: b"", _DOMAIN: b""}
        attributes = []
        for number, value in self._fields(message):
            if number in names:
                names[number] = bytes(_message(value))
            elif number == _ATTRIBUTE:
                attributes.append(_message(value))
        operator, domain = (names[each].decode(errors="replace") for each in (_OPERATOR, _DOMAIN))
        if operator not in OPERATORS.get(domain, ()):
            full_name = f"{domain}.{operator}" if domain else operator
            raise _RefusedError(f"uses the operator {full_name!r:.60}, which is not run here", _STANDARD_FIX)
        for attribute in attributes:
            self._attribute(attribute, depth_left)

    def _attribute(self, message: memoryview, depth_left: int) -> None:
        for number, value in self._fields(message):
            if number == _SUBGRAPHS or (number == _SUBGRAPH and depth_left == 0):
                raise _RefusedError("has branches in branches", "export it for a fixed input size")
            if number == _SUBGRAPH:
                self._graph(_message(value), depth_left - 1)
            if number in _SPARSE_TENSORS:
                raise _RefusedError("has sparse constants", "export it with dense constants")
            if number in (_TENSOR, _TENSORS):
                self._tensor(_message(value))

    def _tensor(self, message: memoryview) -> None:
        for number, value in self._fields(message):
            # onnxruntime takes a location for a file's path, or even for an address in memory.
            if number == _EXTERNAL_DATA or (number == _DATA_LOCATION and value != 0):
                raise _RefusedError("keeps weights outside its file", "export it as one file, without external data")


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("it is damaged")
    return value
