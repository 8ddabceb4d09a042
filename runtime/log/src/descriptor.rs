//! What the protobuf messages look like, in the form that readers need: a `FileDescriptorSet` with all of them.
//!
//! One line a field: name, number, type. `?` marks an optional field, `*` a repeated one, a capital letter the name of
//! another message.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};

const TIMESTAMP: &str = "seconds 1 int64; nanos 2 int32";

const FOXGLOVE: [(&str, &str); 14] = [
    ("Vector3", "x 1 double; y 2 double; z 3 double"),
    (
        "Quaternion",
        "x 1 double; y 2 double; z 3 double; w 4 double",
    ),
    ("Pose", "position 1 Vector3; orientation 2 Quaternion"),
    (
        "PoseInFrame",
        "timestamp 1 Timestamp; frame_id 2 string; pose 3 Pose",
    ),
    (
        "FrameTransform",
        "timestamp 1 Timestamp; parent_frame_id 2 string; child_frame_id 3 string; translation 4 Vector3; rotation 5 Quaternion",
    ),
    ("FrameTransforms", "transforms 1 FrameTransform*"),
    (
        "ModelPrimitive",
        "pose 1 Pose; scale 2 Vector3; media_type 6 string; data 7 bytes",
    ),
    (
        "SceneEntity",
        "timestamp 1 Timestamp; frame_id 2 string; id 3 string; frame_locked 5 bool; models 14 ModelPrimitive*",
    ),
    ("SceneUpdate", "entities 2 SceneEntity*"),
    (
        "JointState",
        "name 1 string; position 2 double?; velocity 3 double?; acceleration 4 double?; effort 5 double?",
    ),
    ("JointStates", "timestamp 1 Timestamp; joints 2 JointState*"),
    (
        "CompressedImage",
        "timestamp 1 Timestamp; data 2 bytes; format 3 string; frame_id 4 string",
    ),
    (
        "CameraCalibration",
        "timestamp 1 Timestamp; width 2 fixed32; height 3 fixed32; distortion_model 4 string; \
         D 5 double*; K 6 double*; R 7 double*; P 8 double*; frame_id 9 string",
    ),
    (
        "Log",
        "timestamp 1 Timestamp; level 2 Level; message 3 string; name 4 string; file 5 string; line 6 fixed32",
    ),
];

const LEVELS: [&str; 6] = ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"];

/// The descriptors of every protobuf message in the log, encoded; each message's schema carries all of them.
pub(super) fn file_descriptor_set() -> Vec<u8> {
    let timestamp = FileDescriptorProto {
        name: Some("google/protobuf/timestamp.proto".to_owned()),
        package: Some("google.protobuf".to_owned()),
        message_type: vec![message("Timestamp", TIMESTAMP)],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    let mut messages: Vec<_> = FOXGLOVE
        .iter()
        .map(|(name, fields)| message(name, fields))
        .collect();
    for log in messages
        .iter_mut()
        .filter(|message| message.name() == "Log")
    {
        log.enum_type.push(levels());
    }
    let foxglove = FileDescriptorProto {
        name: Some("foxglove/messages.proto".to_owned()),
        package: Some("foxglove".to_owned()),
        dependency: vec!["google/protobuf/timestamp.proto".to_owned()],
        message_type: messages,
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet {
        file: vec![timestamp, foxglove],
    }
    .encode_to_vec()
}

fn levels() -> EnumDescriptorProto {
    let value = LEVELS
        .iter()
        .zip(0..)
        .map(|(name, number)| EnumValueDescriptorProto {
            name: Some((*name).to_owned()),
            number: Some(number),
            ..EnumValueDescriptorProto::default()
        })
        .collect();
    EnumDescriptorProto {
        name: Some("Level".to_owned()),
        value,
        ..EnumDescriptorProto::default()
    }
}

fn message(name: &str, fields: &str) -> DescriptorProto {
    let mut message = DescriptorProto {
        name: Some(name.to_owned()),
        ..DescriptorProto::default()
    };
    for line in fields.split(';') {
        let mut words = line.split_whitespace();
        let (Some(field), Some(number), Some(kind)) = (words.next(), words.next(), words.next())
        else {
            continue;
        };
        let mut described = self::field(field, number, kind.trim_end_matches(['?', '*']));
        if kind.ends_with('*') {
            described.set_label(Label::Repeated);
        }
        if kind.ends_with('?') {
            // In proto3 an optional field is the only member of a oneof of its own.
            described.proto3_optional = Some(true);
            described.oneof_index = i32::try_from(message.oneof_decl.len()).ok();
            message.oneof_decl.push(OneofDescriptorProto {
                name: Some(format!("_{field}")),
                ..OneofDescriptorProto::default()
            });
        }
        message.field.push(described);
    }
    message
}

fn field(name: &str, number: &str, kind: &str) -> FieldDescriptorProto {
    let mut field = FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: number.parse().ok(),
        ..FieldDescriptorProto::default()
    };
    field.set_label(Label::Optional);
    match kind {
        "double" => field.set_type(Type::Double),
        "int64" => field.set_type(Type::Int64),
        "int32" => field.set_type(Type::Int32),
        "fixed32" => field.set_type(Type::Fixed32),
        "string" => field.set_type(Type::String),
        "bytes" => field.set_type(Type::Bytes),
        "bool" => field.set_type(Type::Bool),
        "Level" => {
            field.set_type(Type::Enum);
            field.type_name = Some(".foxglove.Log.Level".to_owned());
        }
        "Timestamp" => {
            field.set_type(Type::Message);
            field.type_name = Some(".google.protobuf.Timestamp".to_owned());
        }
        other => {
            field.set_type(Type::Message);
            field.type_name = Some(format!(".foxglove.{other}"));
        }
    }
    field
}
