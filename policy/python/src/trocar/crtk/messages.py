"""The ROS 2 messages that CRTK needs, with the type names and the field order that ROS 2 gives them on DDS."""

# Without `from __future__ import annotations`: Cyclone DDS reads the annotations, and as text it does not understand all of them.

from dataclasses import dataclass, field
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32

from .cdr import CdrReader, CdrWriter


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """``builtin_interfaces/Time``; zero marks data that is not valid."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @property
    def ns(self) -> int:
        """Nanoseconds."""
        return int(self.sec) * 1_000_000_000 + int(self.nanosec)

    @classmethod
    def of(cls, ns: int) -> "Time":
        """The time `ns`, nanoseconds."""
        return cls(*divmod(ns, 1_000_000_000))


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """``std_msgs/Header``."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""

    @classmethod
    def read(cls, reader: CdrReader) -> "Header":
        """The header at the beginning of a message."""
        return cls(Time(reader.number("i"), reader.number("I")), reader.text())

    def write(self, writer: CdrWriter) -> None:
        """Writes it at the beginning of a message."""
        writer.number("i", self.stamp.sec)
        writer.number("I", self.stamp.nanosec)
        writer.text(self.frame_id)


@dataclass
@final
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """``sensor_msgs/JointState``: rad and rad/s, m and m/s, N m and N. CRTK has each list empty or complete."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None) -> bytes:
        """As the generated one does it, in plain CDR."""
        writer = CdrWriter()
        self.header.write(writer)
        writer.texts(self.name)
        for numbers in (self.position, self.velocity, self.effort):
            writer.doubles(numbers)
        return writer.message()


@dataclass
@final
class OperatingState(IdlStruct, typename="crtk_msgs::msg::dds_::OperatingState_"):
    """``crtk_msgs/OperatingState``: DISABLED, ENABLED, PAUSED or FAULT."""

    header: Header = field(default_factory=Header)
    state: str = ""
    is_homed: bool = False
    is_busy: bool = False


@dataclass
@final
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    """``sensor_msgs/RegionOfInterest``."""

    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
@final
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    """``sensor_msgs/CameraInfo``: `k` is the row-major camera matrix, pixels, all zero if the camera is not calibrated."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    distortion_model: str = ""
    d: sequence[float64] = field(default_factory=list)
    k: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    r: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    p: array[float64, 12] = field(default_factory=lambda: [0.0] * 12)
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)


@dataclass
@final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """``sensor_msgs/Image``: rows of `step` bytes."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    encoding: str = ""
    is_bigendian: uint8 = 0
    step: uint32 = 0
    data: sequence[uint8] = b""

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> "Image":
        """As the generated one does it, from plain CDR; `data` is a view."""
        reader = CdrReader(data)
        return cls(
            header=Header.read(reader),
            height=reader.number("I"),
            width=reader.number("I"),
            encoding=reader.text(),
            is_bigendian=reader.number("B"),
            step=reader.number("I"),
            data=reader.octets(),
        )


#: ROS 2's hashes of the types, which its tools look for in an endpoint's user data from Iron on.
TYPE_HASHES: dict[type[IdlStruct], str] = {
    JointState: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    OperatingState: "RIHS01_5cc57eea589b217fe5194bf2735b91d4a7f2dd5ac1245ae657f7ea7590c2c80e",
    CameraInfo: "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    Image: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
}
