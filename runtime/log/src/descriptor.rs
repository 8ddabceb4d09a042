//! What the protobuf messages look like, in the form that readers need: a `FileDescriptorSet` with
//! all of them, made from how their structs are written ([`super::messages`]).
//!
//! Two files: `google/protobuf/timestamp.proto` and one with all of Foxglove's messages. Every
//! protobuf schema in a file carries the whole set.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};

use super::messages::{FIELDS, Fields, LogLevel};

/// The one message that is not Foxglove's.
const TIMESTAMP: &str = "Timestamp";

/// The file that it is from.
const TIMESTAMP_FILE: &str = "google/protobuf/timestamp.proto";

/// The descriptors of every protobuf message in the log, encoded; each message's schema carries all
/// of them.
pub(super) fn file_descriptor_set() -> Vec<u8> {
    let (timestamp, mut messages): (Vec<_>, Vec<_>) = FIELDS
        .iter()
        .map(|(name, fields)| message(name, fields))
        .partition(|message| message.name() == TIMESTAMP);
    for log in messages
        .iter_mut()
        .filter(|message| message.name() == "Log")
    {
        log.enum_type.push(levels());
    }
    let timestamp = file(TIMESTAMP_FILE, "google.protobuf", timestamp);
    let foxglove = FileDescriptorProto {
        dependency: vec![TIMESTAMP_FILE.to_owned()],
        ..file("foxglove/messages.proto", "foxglove", messages)
    };
    FileDescriptorSet {
        file: vec![timestamp, foxglove],
    }
    .encode_to_vec()
}

/// The file `name` of a protobuf package, without dependencies.
fn file(name: &str, package: &str, messages: Vec<DescriptorProto>) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        message_type: messages,
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    }
}

/// The enumeration of `foxglove.Log`.
fn levels() -> EnumDescriptorProto {
    let levels = (0..).map_while(|number| LogLevel::try_from(number).ok());
    let value = levels.map(|level| EnumValueDescriptorProto {
        name: Some(format!("{level:?}").to_uppercase()),
        number: Some(level.into()),
        ..EnumValueDescriptorProto::default()
    });
    EnumDescriptorProto {
        name: Some("Level".to_owned()),
        value: value.collect(),
        ..EnumDescriptorProto::default()
    }
}

/// The descriptor of a message; optional fields are one-ofs of their own, as `proto3` has them.
fn message(name: &str, fields: Fields) -> DescriptorProto {
    let mut message = DescriptorProto {
        name: Some(name.to_owned()),
        ..DescriptorProto::default()
    };
    for (name, kind, of) in fields {
        let (mut field, optional) = field(name, kind, of);
        if optional {
            // In proto3 an optional field is the only member of a oneof of its own.
            field.proto3_optional = Some(true);
            field.oneof_index = i32::try_from(message.oneof_decl.len()).ok();
            message.oneof_decl.push(OneofDescriptorProto {
                name: Some(format!("_{name}")),
                ..OneofDescriptorProto::default()
            });
        }
        message.field.push(field);
    }
    message
}

/// A field of this `kind`, as in `#[prost(kind)]`, whose struct's field is an `of`; and whether it
/// is a value that may be absent.
///
/// `kind` is read as text: the first word is the scalar's type, `tag = "n"` the number, `repeated`
/// and `optional` the label. `of` tells the message's name, out of an `Option` or a `Vec`.
fn field(name: &str, kind: &str, of: &str) -> (FieldDescriptorProto, bool) {
    let mut words = kind.split(',').map(str::trim);
    let scalar = words.next().and_then(|word| word.split_whitespace().next());
    let mut field = FieldDescriptorProto {
        name: Some(name.to_owned()),
        ..FieldDescriptorProto::default()
    };
    field.set_label(Label::Optional);
    let mut optional = false;
    for word in words {
        match word {
            "repeated" => field.set_label(Label::Repeated),
            "optional" => optional = true,
            tag => field.number = tag.split('"').nth(1).and_then(|number| number.parse().ok()),
        }
    }
    let name = |package: &str, of: &str| Some(format!(".{package}.{of}"));
    match scalar {
        Some("double") => field.set_type(Type::Double),
        Some("int64") => field.set_type(Type::Int64),
        Some("int32") => field.set_type(Type::Int32),
        Some("fixed32") => field.set_type(Type::Fixed32),
        Some("string") => field.set_type(Type::String),
        Some("bytes") => field.set_type(Type::Bytes),
        Some("bool") => field.set_type(Type::Bool),
        Some("enumeration") => {
            field.set_type(Type::Enum);
            field.type_name = name("foxglove", "Log.Level");
        }
        _ => {
            field.set_type(Type::Message);
            let of = of.split(['<', '>']).nth(1).unwrap_or(of).trim();
            let package = if of == TIMESTAMP {
                "google.protobuf"
            } else {
                "foxglove"
            };
            field.type_name = name(package, of);
            optional = false;
        }
    }
    (field, optional)
}
