"""Definitions of ROS 2 messages in the one form that is decoded, ``ros2msg``.

A bag of SQLite files holds no definitions before ROS 2 Iron, and some logs hold them as IDL. The library
`rosbags` knows the standard messages and reads IDL.
"""

from dataclasses import replace
from types import ModuleType

from mcap.records import Schema
from mcap.well_known import SchemaEncoding

IDL = "ros2idl"
BORDER = "=" * 80 + "\n"  # between the definitions of a message and of those inside it


def complete_definition(schema: Schema) -> Schema:
    """The schema of a ROS 2 message with its definition as ``ros2msg``, as it is where it has one.

    Standard messages without a definition get that of ROS 2 Humble, the last release that wrote none.

    Raises:
        ValueError: the message is no standard one, its IDL cannot be read, or `rosbags` is not installed.
    """
    if schema.encoding not in ("", IDL) or (schema.encoding == "" and schema.data):
        return schema
    typesys = _require_rosbags(schema)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    known = dict(store.fielddefs)
    try:
        if schema.encoding == IDL:
            # into the table alone: to register a type, rosbags runs code that it makes of its names
            for part in schema.data.decode().split(BORDER):
                text = part.partition("\n")[2] if part.startswith("IDL: ") else part
                known.update(typesys.get_types_from_idl(text) if text.strip() else {})
        store.fielddefs = known
        text, _ = store.generate_msgdef(schema.name, ros_version=2)
    except (typesys.base.TypesysError, UnicodeDecodeError) as error:
        origin = "its definition cannot be read" if schema.data else "the log has no definition of it"
        raise ValueError(
            f"the message type {schema.name} is unknown: {origin} ({error}). Where this type is installed, "
            "`ros2 bag convert` makes a bag in storage mcap, which keeps definitions; or leave the topic out"
        ) from error
    return replace(schema, encoding=SchemaEncoding.ROS2, data=text.encode())


def _require_rosbags(schema: Schema) -> ModuleType:
    try:
        import rosbags.typesys
        import rosbags.typesys.base
    except ImportError as error:
        form = "as IDL" if schema.encoding == IDL else "nowhere, as in bags before ROS 2 Iron"
        raise ValueError(
            f"the log defines {schema.name} {form}, which needs the package rosbags; install it with: "
            "pip install 'lagsplat[ros]'"
        ) from error
    return rosbags.typesys
