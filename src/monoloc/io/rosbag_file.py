"""Access to the messages of a ROS 1 or ROS 2 bag, through the package ``rosbags``.

ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0), ROS 2 bags (a folder with ``metadata.yaml``, stored as SQLite or as
MCAP) and single ``.db3`` and ``.mcap`` files. Messages are decoded by the definitions of ROS itself, not by those in
the bag: the types that are read here are the same in all distributions.
"""

from __future__ import annotations

import re
import struct
import threading
import weakref
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.extras import require_extra

_ROS1, _MCAP, _SQLITE = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00"
_METADATA, _METADATA_KEY = "metadata.yaml", b"rosbag2_bagfile_information"
_ZSTD = b"\x28\xb5\x2f\xfd"
_TF = "tf2_msgs/msg/TFMessage"
_RENAMED = {"tf/msg/tfMessage": _TF}  # the same content
_COPY = "copy the bag again"
# What rosbags says of a bag that it does not read, and the fix.
_FIXES = {
    r"encryption": "decrypt it with: rosbag decrypt BAG",
    r"not indexed|index looks damaged|Could not read|Header could not": "repair it with: rosbag reindex BAG",
    r"Bag version": "convert it with: rosbag fix, or rosbag migrate",
    r"Compression '.*' is not supported": "unpack it with: rosbag decompress BAG",
    r"ompression": "record it with zstd or without compression, or convert it with: ros2 bag convert",
    r"Profile is not ros2": "give a file of ROS 2 messages, with the profile ros2: ros2 bag convert writes one",
    r"MCAP|end magic|Truncated record|[Cc]hunk": "repair it with: mcap recover IN -o OUT",
    r"etadata|YAML|database files are missing": "restore metadata.yaml with: ros2 bag reindex FOLDER",
}


@dataclass(frozen=True)
class Header:
    """What the header of a stamped message says.

    Attributes:
        stamp_ns: time of the data, nanoseconds; 0 if it was not set.
        frame_id: the frame's name, without a leading slash.
    """

    stamp_ns: int
    frame_id: str


def is_bag(path: Path) -> bool:
    """Whether a file starts as a bag does, or a folder contains the ``metadata.yaml`` of one."""
    if path.is_dir():
        return _METADATA_KEY in _start(path / _METADATA, 4096)
    start = _start(path, 16)
    by_suffix = {".mcap": _MCAP, ".db3": _SQLITE}
    return start.startswith(_ROS1) or start.startswith(by_suffix.get(path.suffix, _ROS1))


def _start(path: Path, count: int) -> bytes:
    if not path.is_file():  # a pipe would wait for its writer
        return b""
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


class BagFile:
    """The messages of a bag.

    Attributes:
        path: the file or folder.
        types: type of each topic that has messages, such as ``sensor_msgs/msg/Image``.
        counts: number of messages of each of these topics.

    Raises:
        DataError: it is no bag, is damaged or encrypted, or is stored in a way that cannot be read.
        MissingExtraError: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise DataError(path.absolute(), "does not exist", "check the path")
        if not is_bag(path):
            fix = "give a .bag, .mcap or .db3 file, or a folder with a metadata.yaml (ros2 bag reindex restores it)"
            raise DataError(path, "is not a ROS bag", fix)
        require_extra("ros")
        self.path = path
        self._is_ros1 = path.is_file() and _start(path, 16).startswith(_ROS1)
        self._lock = threading.Lock()  # of the position in the file
        with self._one_line():
            self._reader = self._open()
            self._connections: dict[str, list[Any]] = {}
            for connection in self._reader.connections:
                if connection.msgcount:
                    self._connections.setdefault(connection.topic, []).append(connection)
        self._check_index()
        self.types = {topic: _type_of(each) for topic, each in self._connections.items()}
        self.counts = {topic: sum(c.msgcount for c in each) for topic, each in self._connections.items()}

    def _open(self) -> Any:
        from rosbags.rosbag1 import Reader as Ros1Reader
        from rosbags.rosbag2 import Reader as Ros2Reader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._types = get_typestore(Stores.ROS1_NOETIC if self._is_ros1 else Stores.ROS2_HUMBLE)
        if _TF not in self._types.fielddefs:
            self._types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
        reader = Ros1Reader(self.path) if self._is_ros1 else Ros2Reader(self.path)
        reader.open()
        weakref.finalize(self, reader.close)  # also where what follows refuses the bag
        return reader

    def _check_index(self) -> None:
        """Refuse MCAP files in which each message would be searched for from the start."""
        storage = getattr(self._reader, "storage", None)
        for each in getattr(storage, "storages", [storage]):
            if getattr(each, "chunks", None) == [] and self._connections:
                raise DataError(each.path, "has no index of chunks", "write one with: mcap recover IN -o OUT")

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """All messages of some topics, as (topic, time of recording in nanoseconds, content).

        Raises:
            DataError: the bag is damaged.
        """
        connections = [connection for topic in topics for connection in self._connections[topic]]
        if not connections:
            return
        with self._one_line():
            for connection, time_ns, data in self._reader.messages(connections):
                yield connection.topic, time_ns, bytes(data)

    def message(self, topic: str, time_ns: int, stamp_ns: int) -> bytes:
        """Content of the message of a topic with a time of recording and a time stamp.

        Raises:
            DataError: the bag is damaged, or has changed.
        """
        with self._lock, self._one_line():
            for _, _, data in self._reader.messages(self._connections[topic], start=time_ns, stop=time_ns + 1):
                if self.header(topic, bytes(data)).stamp_ns == stamp_ns:
                    return bytes(data)
        raise DataError(
            self.path, f"no longer holds a message of {topic}", "leave the bag unchanged while it is read"
        )

    def header(self, topic: str, data: bytes) -> Header:
        """Header (std_msgs/Header) of a message that starts with one.

        Raises:
            DataError: the content is none of that kind.
        """
        try:
            if self._is_ros1:  # sequence number, seconds, nanoseconds, length of frame_id
                _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
                start, end = 16, 16 + length
            else:  # CDR: two bytes of encoding, two of options; a string's length counts its final zero
                order = {b"\x00\x00": ">", b"\x00\x01": "<"}[data[:2]]
                seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
                start, end = 16, 16 + length - 1
            if not start <= end <= len(data):
                raise ValueError
            frame_id = data[start:end].decode().strip("/")
        except (struct.error, KeyError, ValueError) as error:
            if data.startswith(_ZSTD):
                problem = f"has compressed messages in {topic}, which a metadata.yaml beside it would describe"
                raise DataError(self.path, problem, "give the folder with its metadata.yaml") from error
            raise DataError(self.path / topic.lstrip("/"), "holds a message without a header", _COPY) from error
        return Header(seconds * 10**9 + nanoseconds, frame_id)

    def decode(self, topic: str, data: bytes) -> Any:
        """A message, with the attributes of its type.

        Raises:
            DataError: the content is not of the topic's type.
        """
        deserialise = self._types.deserialize_ros1 if self._is_ros1 else self._types.deserialize_cdr
        with self._one_line(f"holds a message of {topic} that is not a {self.types[topic]}"):
            return deserialise(data, self.types[topic])

    @contextmanager
    def _one_line(self, problem: str = "cannot be read as a ROS bag") -> Iterator[None]:
        """Report what rosbags raises within as one line.

        rosbags does not check the content of files before it uses it, so a damaged bag may raise any exception.
        """
        try:
            yield
        except DataError:
            raise
        except Exception as error:
            what = " ".join(str(error).replace(f"{str(self.path)!r}", "it").split())[:150].rstrip(".")
            fix = next((fix for pattern, fix in _FIXES.items() if re.search(pattern, what)), _COPY)
            raise DataError(self.path, f"{problem} ({what or type(error).__name__})", fix) from error


def _type_of(connections: list[Any]) -> str:
    stated = str(connections[0].msgtype)
    return _RENAMED.get(stated, stated)
