"""A network from elsewhere reads no file, starts no loop, and takes bounded memory and time, or it is refused."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, helper, numpy_helper

from monoloc.bundle import read_network
from monoloc.camera import Camera
from monoloc.depth import predictor
from monoloc.depth.models import shipped_file, shipped_models
from monoloc.depth.network_check import check_network
from monoloc.depth.onnx_operators import OPERATORS
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.session import load_session, run_within
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from onnx_networks import IMAGE, MIDAS, graph, onnx_network, toml_of
from refusals import refuses

ONE_FILE = "export it as one file, without external data"
CAMERA = Camera(128, 128, 100.0, 100.0, 63.5, 63.5)


def network() -> ModelProto:
    return ModelProto.FromString(onnx_network(MIDAS))


def outside(tensor: TensorProto, location: str = "../secret.bin") -> TensorProto:
    """The tensor with its numbers in another file."""
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    return tensor


def empty_graph() -> GraphProto:
    return helper.make_graph([], "inner", [], [])


def constant() -> TensorProto:
    return numpy_helper.from_array(np.zeros(4, np.float32), "constant")


def external_weight(model: ModelProto) -> None:
    outside(model.graph.initializer[0])


def address_in_memory(model: ModelProto) -> None:
    outside(model.graph.initializer[0], "*/_ORT_MEM_ADDR_/*")


def location_without_a_path(model: ModelProto) -> None:
    model.graph.initializer[0].data_location = TensorProto.EXTERNAL


def path_without_a_location(model: ModelProto) -> None:
    outside(model.graph.initializer[0]).ClearField("data_location")


def external_constant(model: ModelProto) -> None:
    model.graph.node.append(helper.make_node("Constant", [], ["c"], value=outside(constant())))


def external_constant_of_several(model: ModelProto) -> None:
    model.graph.node[0].attribute.append(helper.make_attribute("others", [constant(), outside(constant())]))


def sparse_weight(model: ModelProto) -> None:
    model.graph.sparse_initializer.add().dims.append(2**40)


def sparse_constant(model: ModelProto) -> None:
    model.graph.node[0].attribute.add(name="sparse").sparse_tensor.dims.append(2**40)


def operators_of_its_own(model: ModelProto) -> None:
    model.functions.add(name="mine", domain="mine")


def training_graph(model: ModelProto) -> None:
    model.training_info.add()


def branches(depth: int, inner: GraphProto) -> Callable[[ModelProto], None]:
    """Branches in branches, with a graph in the innermost."""

    def add(model: ModelProto) -> None:
        body = inner
        for _ in range(depth):
            body = helper.make_graph([helper.make_node("If", [], [], then_branch=body)], "branch", [], [])
        model.graph.node.extend(body.node)

    return add


def loop_in_a_branch(model: ModelProto) -> None:
    branches(2, helper.make_graph([helper.make_node("Loop", [], [])], "inner", [], []))(model)


def external_weight_in_a_branch(model: ModelProto) -> None:
    branches(1, helper.make_graph([], "inner", [], [], [outside(constant())]))(model)


def hidden_graphs(model: ModelProto) -> None:
    model.graph.node[0].attribute.append(helper.make_attribute("bodies", [empty_graph()]))


def node(operator: str, domain: str = "", **attributes: object) -> Callable[[ModelProto], None]:
    def add(model: ModelProto) -> None:
        made: NodeProto = helper.make_node(operator, [], ["made"], domain=domain, **attributes)
        model.graph.node.append(made)

    return add


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (external_weight, f"keeps weights outside its file; {ONE_FILE}"),
        (address_in_memory, f"keeps weights outside its file; {ONE_FILE}"),
        (location_without_a_path, f"keeps weights outside its file; {ONE_FILE}"),
        (path_without_a_location, f"keeps weights outside its file; {ONE_FILE}"),
        (external_constant, f"keeps weights outside its file; {ONE_FILE}"),
        (external_constant_of_several, f"keeps weights outside its file; {ONE_FILE}"),
        (sparse_weight, "has sparse weights; export it with dense weights"),
        (sparse_constant, "has sparse constants; export it with dense constants"),
        (operators_of_its_own, "defines operators of its own; export it with its functions inlined"),
        (training_graph, "holds graphs for its training; export it for inference"),
        (hidden_graphs, "has branches in branches; export it for a fixed input size"),
        (branches(5, empty_graph()), "has branches in branches; export it for a fixed input size"),
        (branches(20, empty_graph()), "has branches in branches; export it for a fixed input size"),
        (loop_in_a_branch, "uses the operator 'Loop', which is not run here"),
        (external_weight_in_a_branch, "keeps weights outside its file"),
        (node("Loop", body=empty_graph()), "uses the operator 'Loop', which is not run here; export"),
        (node("Scan", body=empty_graph()), "uses the operator 'Scan', which is not run here"),
        (node("RandomNormal"), "uses the operator 'RandomNormal', which is not run here"),
        (node("EPContext", "com.microsoft"), r"uses the operator 'com\.microsoft\.EPContext', which is not run here"),
        (node("Conv", "mine\x1b[31m"), r"uses the operator 'mine\\x1b\[31m\.Conv', which is not run here"),
    ],
)
def test_network_that_could_reach_out_or_never_end_is_refused(
    change: Callable[[ModelProto], None], problem: str
) -> None:
    model = network()
    change(model)
    refuses(lambda: load_session(model.SerializeToString(), "another.onnx"), DataError, f"^another.onnx: {problem}")


def test_second_value_of_a_field_does_not_hide_the_first() -> None:
    """Protocol buffers merge a field that comes twice."""
    model = network()
    external_weight(model)
    second = ModelProto()
    second.graph.name = "harmless"
    hidden = model.SerializeToString() + second.SerializeToString()
    refuses(lambda: check_network(hidden, "another.onnx"), DataError, "keeps weights outside its file")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", r"cannot be loaded \(it is no ONNX network\); give one self-contained ONNX file"),
        (b"\x18\x00\x00\x00ORTM" + bytes(100), r"cannot be loaded \(it is damaged\)"),
        (onnx_network(MIDAS)[:-1], r"cannot be loaded \(it is cut short\)"),
        (b"\x3a\x80", r"cannot be loaded \(it is cut short\)"),
        (b"\x3b\x3c", r"cannot be loaded \(it is damaged\)"),
        (b"\x38\x01", r"cannot be loaded \(it is damaged\)"),
        (b"\x3a\x7f", r"cannot be loaded \(it is cut short\)"),
        (b"\x08\x08" * 2_000_001, r"cannot be loaded \(it has too many parts\)"),
        (graph([helper.make_node("Relu", ["pixels"], ["y"])] * 10_001, [IMAGE], [], {}), "more than 10000 operators"),
        (bytes((1 << 28) + 1), r"cannot be loaded \(it is larger than 256 MB\)"),
    ],
    ids=range(10),
)
def test_file_that_is_no_network_is_refused(content: bytes, problem: str) -> None:
    refuses(lambda: check_network(content, "another.onnx"), DataError, problem)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_network_is_refused_or_read(data: st.DataObject) -> None:
    content = bytearray(onnx_network(MIDAS))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        check_network(bytes(content), "another.onnx")
    except DataError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("name", [b"pixels", b"rows", b"result", b"key", b"value", b"chw"])
def test_name_that_is_no_text_is_refused_without_a_word_on_stdout(
    capfd: pytest.CaptureFixture[str], name: bytes
) -> None:
    model = network()
    model.metadata_props.add(key="key", value="value")
    before, _, after = model.SerializeToString().partition(b"chw")  # onnxruntime names it, as it is missing then
    content = before.replace(name, name[:-1] + b"\xff") + b"chw" + after.replace(name, name[:-1] + b"\xff")
    refuses(lambda: load_session(content, "another"), DataError, "another: cannot be loaded .*utf-8")
    assert capfd.readouterr() == ("", "")


def test_described_network_s_weights_are_not_read_from_elsewhere(tmp_path: Path) -> None:
    model = network()
    external_weight(model)
    (tmp_path / "another.onnx").write_bytes(model.SerializeToString())
    (tmp_path / "another.toml").write_text(toml_of(MIDAS))
    refuses(lambda: read_network(tmp_path / "another.toml"), DataError, r"another\.onnx: keeps weights outside")


def test_branches_as_pytorch_writes_them_are_allowed() -> None:
    model = network()
    branches(4, empty_graph())(model)
    check_network(model.SerializeToString(), "another.onnx")


def test_operators_of_shipped_networks_are_allowed() -> None:
    used: set[tuple[str, str]] = set()
    for name in [f"{model.name}{suffix}" for model in shipped_models() for suffix in ("", "-int8")]:
        nodes = ModelProto.FromString(shipped_file(name).read_bytes()).graph.node
        used |= {(each.domain, each.op_type) for each in nodes}
    assert {("", "Conv"), ("", "QLinearConv"), ("com.microsoft", "QLinearAdd")} <= used
    assert all(operator in OPERATORS[domain] for domain, operator in used)


# --- Memory and time ---


def expanded(cells: int, products: int = 0, of: str = "brightest") -> bytes:
    """A network that makes a square of that many cells a side, and multiplies it with itself again and again."""
    nodes = [
        helper.make_node("ReduceMean", ["pixels"], ["grey"], axes=[1], keepdims=1),
        helper.make_node("ReduceMax", ["grey"], ["brightest"], keepdims=0),
        helper.make_node("Expand", [of, "shape"], ["p0"]),
        *(helper.make_node("MatMul", [f"p{i}", "p0"], [f"p{i + 1}"]) for i in range(products)),
        helper.make_node("ReduceMax", [f"p{products}"], ["largest"], keepdims=0),
        helper.make_node("Add", ["grey", "largest"], ["result"]),
    ]
    outputs = [helper.make_tensor_value_info("result", TensorProto.FLOAT, None)]
    return graph(nodes, [IMAGE], outputs, {"shape": np.array([cells, cells]), "constant": np.float32(1e-3)})


def predict(content: bytes) -> DepthPredictor:
    return DepthPredictor(DepthModel(content, MIDAS, "another"), CAMERA)


def test_intermediate_result_of_gigabytes_is_refused_before_it_is_made() -> None:
    predict(expanded(100))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refuses(
        lambda: predict(expanded(30_000)), DataError, "another: cannot be run on images of 128x128.*may take 2 GB"
    )
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # of the 3.6 GB, in kilobytes


@pytest.mark.parametrize("of", ["brightest", "constant"])
def test_first_run_that_takes_too_long_is_ended(monkeypatch: pytest.MonkeyPatch, of: str) -> None:
    """What depends on constants alone is not computed before, when the network is loaded."""
    monkeypatch.setattr(predictor, "_FIRST_RUN_S", 0.5)
    began = time.perf_counter()
    refuses(lambda: predict(expanded(500, 9000, of)), DataError, "a minute for its first image")  # for some minutes
    assert time.perf_counter() - began < 20.0


def test_runs_of_a_forked_process_are_watched_too() -> None:
    with run_within(60.0):
        child = os.fork()
        if child == 0:
            with run_within(0.0) as options:
                time.sleep(1.5)
                os._exit(int(not options.terminate))
        assert os.waitpid(child, 0)[1] == 0


def test_later_run_that_takes_too_long_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise, as in the first run, is answered at once; a black image begins products of some minutes."""
    chain = [helper.make_node("MatMul", [f"p{i}", "p0"], [f"p{i + 1}"]) for i in range(9000)]
    made = helper.make_node("Expand", ["brightest", "shape"], ["p0"])
    sum_of = helper.make_node("ReduceMax", ["p9000"], ["many"], keepdims=0)
    none = helper.make_node("Identity", ["brightest"], ["none"])
    long, short = (
        helper.make_graph(nodes, name, [], [helper.make_tensor_value_info(name, TensorProto.FLOAT, [])])
        for nodes, name in (([made, *chain, sum_of], "many"), ([none], "none"))
    )
    nodes = [
        helper.make_node("ReduceMean", ["pixels"], ["grey"], axes=[1], keepdims=1),
        helper.make_node("ReduceMax", ["grey"], ["brightest"], keepdims=0),
        helper.make_node("Less", ["brightest", "dark"], ["is_dark"]),
        helper.make_node("If", ["is_dark"], ["largest"], then_branch=long, else_branch=short),
        helper.make_node("Add", ["grey", "largest"], ["result"]),
    ]
    outputs = [helper.make_tensor_value_info("result", TensorProto.FLOAT, None)]
    model = ModelProto.FromString(graph(nodes, [IMAGE], outputs, {"dark": np.float32(-1.0)}))
    model.graph.initializer.append(numpy_helper.from_array(np.array([500, 500]), "shape"))
    monkeypatch.setattr(predictor, "_LATER_RUN_S", 0.5)
    predictor_of_both = predict(model.SerializeToString())
    assert np.isfinite(predictor_of_both.raw(np.full((128, 128, 3), 255, np.uint8))).all()
    began = time.perf_counter()
    black = np.zeros((128, 128, 3), np.uint8)
    refuses(lambda: predictor_of_both.raw(black), DataError, "10 s for others")
    assert time.perf_counter() - began < 20.0
