//! Names, types and order of the columns, as LeRobot's `info.json` and as Arrow schemas.
//!
//! The same order holds for the features in `info.json`, the columns of a data file and the arrays
//! that `episode::columns` makes: state, tip pose, action, cameras, depth of each camera that keeps
//! it, `intervention`, `timestamp`, indices.

use std::{collections::BTreeMap, sync::Arc};

use arrow_schema::{DataType, Field, Schema};
use hal::{ARM_NAMES, Intrinsics, joints::JOINT_NAMES};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{MapAccess, Visitor},
    ser::SerializeMap,
};
use serde_json::{Value, json};

use super::{ACTION_WIDTH, CameraSpec, DatasetSpec, STATE_WIDTH, TIP_POSE_WIDTH, VideoCodec};
use crate::perception::DEPTH_UNIT_M;

/// What this program writes, LeRobot's `codebase_version`.
pub(super) const VERSION: &str = "v3.0";
/// Versions that are read.
pub(super) const READABLE: [&str; 3] = [VERSION, "v2.1", "v2.0"];
/// Measured joints and jaws, `float32`.
pub(crate) const STATE: &str = "observation.state";
/// Measured tip poses, `float64`: a feature of ours, which LeRobot treats as any other vector.
pub(super) const TIP_POSE: &str = "observation.tip_pose";
/// Commanded tip poses and jaws, `float32`.
pub(crate) const ACTION: &str = "action";
/// What a camera's feature begins with; its name follows.
pub(crate) const IMAGE_PREFIX: &str = "observation.images.";
/// Likewise of its depth.
pub(super) const DEPTH_PREFIX: &str = "observation.depth.";
pub(super) const INSTANCE_PREFIX: &str = "observation.instance.";
pub(super) const CAMERA_POSE_PREFIX: &str = "observation.camera_pose.";
/// Whether an operator drove and not the policy: as LeRobot calls it.
pub(super) const INTERVENTION: &str = "intervention";
/// Seconds since the episode began, `float32`.
pub(crate) const TIMESTAMP: &str = "timestamp";
pub(super) const EPISODE_INDEX: &str = "episode_index";
/// Integer columns that every LeRobot dataset ends with.
pub(crate) const INDICES: [&str; 4] = ["frame_index", EPISODE_INDEX, "index", "task_index"];

/// Order of a pose's numbers: the quaternion's real part last, as in ROS and SciPy.
const POSE_NAMES: [&str; TIP_POSE_WIDTH] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// `meta/info.json`. Keys that are not listed here are ignored when it is read.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Info {
    pub(super) codebase_version: String,
    pub(super) robot_type: Option<String>,
    pub(super) total_episodes: usize,
    pub(super) total_frames: usize,
    pub(super) total_tasks: usize,
    /// Files in a folder `chunk-NNN`.
    pub(super) chunks_size: usize,
    // Of v3.0 alone.
    #[serde(default)]
    pub(super) data_files_size_in_mb: usize,
    #[serde(default)]
    pub(super) video_files_size_in_mb: usize,
    pub(super) fps: u32,
    /// Ranges `FROM:TO` of episodes by name.
    #[serde(default)]
    pub(super) splits: BTreeMap<String, String>,
    pub(super) data_path: String,
    pub(super) video_path: Option<String>,
    /// A JSON object, kept in the order of the file: cameras are numbered by it.
    #[serde(
        serialize_with = "serialize_in_order",
        deserialize_with = "deserialize_in_order"
    )]
    pub(super) features: Vec<(String, Feature)>,
    // Ours alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) trocar: Option<Value>,
}

/// One entry of `features`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Feature {
    /// `float32`, `float64`, `int64`, `bool`, `string`, `image` or `video`.
    pub(super) dtype: String,
    /// Of one row; `[height, width, 3]` of an image.
    pub(super) shape: Vec<usize>,
    /// A list of the numbers' names, an object of such lists, or null.
    #[serde(default)]
    pub(super) names: Value,
    /// Of a video its codec and size, of depth its unit and lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) info: Option<Value>,
}

impl Feature {
    fn new(dtype: &str, shape: &[usize], names: Value) -> Self {
        Self {
            dtype: dtype.to_owned(),
            shape: shape.to_vec(),
            names,
            info: None,
        }
    }
}

pub(crate) fn image_feature(camera: &str) -> String {
    format!("{IMAGE_PREFIX}{camera}")
}

/// The names in a vector of `arms` arms, from those of one: of several, each begins with its arm's,
/// as in LeRobot's bimanual datasets.
fn of_arms(arms: usize, names: &[&str]) -> Vec<String> {
    if arms == 1 {
        return names.iter().map(|&name| name.to_owned()).collect();
    }
    let mut all = Vec::with_capacity(arms * names.len());
    for arm in ARM_NAMES.iter().take(arms) {
        all.extend(names.iter().map(|name| format!("{arm}_{name}")));
    }
    all
}

/// Every feature of a dataset, in column order; the colour is kept as PNG or as video. With video a
/// camera has its feature here and no column in the data files.
pub(super) fn features(spec: &DatasetSpec, video: Option<VideoCodec>) -> Vec<(String, Feature)> {
    let vector = |dtype: &str, names: &[&str]| {
        let names = of_arms(spec.arms, names);
        Feature::new(dtype, &[names.len()], json!(names))
    };
    let with_jaw = |names: &[&'static str]| [names, &["jaw"]].concat();
    let mut features = vec![
        (STATE.to_owned(), vector("float32", &with_jaw(&JOINT_NAMES))),
        (TIP_POSE.to_owned(), vector("float64", &POSE_NAMES)),
        (ACTION.to_owned(), vector("float32", &with_jaw(&POSE_NAMES))),
    ];
    for CameraSpec {
        name,
        width,
        height,
        ..
    } in &spec.cameras
    {
        let shape = [*height as usize, *width as usize, 3];
        let names = json!(["height", "width", "channels"]);
        let feature = match video {
            None => Feature::new("image", &shape, names),
            Some(codec) => Feature {
                info: Some(describe_video(codec, shape, spec.fps)),
                ..Feature::new("video", &shape, names)
            },
        };
        features.push((image_feature(name), feature));
    }
    for (camera, lens) in spec.depth_cameras() {
        let shape = [camera.height as usize, camera.width as usize, 1];
        let image = || Feature::new("image", &shape, json!(["height", "width", "channels"]));
        let depth = Feature {
            info: Some(describe_depth(&lens)),
            ..image()
        };
        let name = &camera.name;
        features.push((format!("{DEPTH_PREFIX}{name}"), depth));
        features.push((format!("{INSTANCE_PREFIX}{name}"), image()));
        let pose = Feature::new("float64", &[POSE_NAMES.len()], json!(POSE_NAMES));
        features.push((format!("{CAMERA_POSE_PREFIX}{name}"), pose));
    }
    if spec.intervention {
        let feature = Feature::new("bool", &[1], Value::Null);
        features.push((INTERVENTION.to_owned(), feature));
    }
    features.push((
        TIMESTAMP.to_owned(),
        Feature::new("float32", &[1], Value::Null),
    ));
    for name in INDICES {
        features.push((name.to_owned(), Feature::new("int64", &[1], Value::Null)));
    }
    features
}

/// What `info.json` says about a camera's depth; nothing of the distortion of a pinhole.
fn describe_depth(lens: &Intrinsics) -> Value {
    let mut described = json!({
        "is_depth_map": true,
        "depth_unit_m": DEPTH_UNIT_M,
        "intrinsics_px": {"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy},
    });
    if !lens.distortion.is_none() {
        described["distortion"] = json!(lens.distortion.coefficients());
    }
    described
}

/// What `info.json` says about a camera's video.
pub(crate) fn describe_video(
    codec: VideoCodec,
    [height, width, channels]: [usize; 3],
    fps: u32,
) -> Value {
    json!({
        "video.height": height,
        "video.width": width,
        "video.codec": codec.name(),
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": false,
        "video.fps": fps,
        "video.channels": channels,
        "has_audio": false,
    })
}

/// Schema of the data files; a camera that is kept as video has no column. All fields are nullable,
/// as in the files that LeRobot writes; values never are.
pub(super) fn data_schema(spec: &DatasetSpec, video: Option<VideoCodec>) -> Schema {
    let mut fields = vec![
        vector_field(STATE, DataType::Float32, spec.arms * STATE_WIDTH),
        vector_field(TIP_POSE, DataType::Float64, spec.arms * TIP_POSE_WIDTH),
        vector_field(ACTION, DataType::Float32, spec.arms * ACTION_WIDTH),
    ];
    let image = |name: String| Field::new(name, DataType::Struct(image_fields()), true);
    for camera in spec.cameras.iter().filter(|_| video.is_none()) {
        fields.push(image(image_feature(&camera.name)));
    }
    for (camera, _) in spec.depth_cameras() {
        for prefix in [DEPTH_PREFIX, INSTANCE_PREFIX] {
            fields.push(image(format!("{prefix}{}", camera.name)));
        }
        let name = format!("{CAMERA_POSE_PREFIX}{}", camera.name);
        fields.push(vector_field(&name, DataType::Float64, TIP_POSE_WIDTH));
    }
    if spec.intervention {
        fields.push(Field::new(INTERVENTION, DataType::Boolean, true));
    }
    fields.push(Field::new(TIMESTAMP, DataType::Float32, true));
    fields.extend(INDICES.map(|name| Field::new(name, DataType::Int64, true)));
    Schema::new(fields)
}

/// Parts of an image column, as Hugging Face `datasets` stores them. `path` is only a name; the
/// image is in `bytes`.
pub(super) fn image_fields() -> arrow_schema::Fields {
    vec![
        Field::new("bytes", DataType::Binary, true),
        Field::new("path", DataType::Utf8, true),
    ]
    .into()
}

/// Schema of `tasks.parquet`: the text is the pandas index.
///
/// pandas looks for its metadata in the Arrow schema; in the parquet footer alone they would be
/// ignored without a word and every frame would report a number instead of its task.
pub(super) fn tasks_schema() -> Schema {
    let column = |name: &str, pandas: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy, "metadata": null});
    let pandas = json!({
        "index_columns": ["task"],
        "column_indexes": [{"name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"}}],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "trocar", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.2.3",
    });
    let fields = vec![
        Field::new("task_index", DataType::Int64, true),
        Field::new("task", DataType::Utf8, true),
    ];
    Schema::new(fields).with_metadata([("pandas".to_owned(), pandas.to_string())])
}

/// Integer columns of the episodes table, in order, after which comes the list of tasks.
pub(super) const EPISODE_COLUMNS: [&str; 8] = [
    EPISODE_INDEX,
    "length",
    "data/chunk_index",
    "data/file_index",
    "dataset_from_index",
    "dataset_to_index",
    "meta/episodes/chunk_index",
    "meta/episodes/file_index",
];

/// Columns of the episodes table about the video of `feature`: two numbers of its file, and the
/// times there (s).
pub(super) fn video_columns(feature: &str) -> [String; 4] {
    let parts = [
        "chunk_index",
        "file_index",
        "from_timestamp",
        "to_timestamp",
    ];
    parts.map(|part| format!("videos/{feature}/{part}"))
}

/// Schema of the episodes table; `videos` are the features that are kept as video.
pub(super) fn episodes_schema(videos: &[String]) -> Schema {
    let mut fields: Vec<Field> = EPISODE_COLUMNS
        .iter()
        .map(|name| Field::new(*name, DataType::Int64, true))
        .collect();
    fields.push(Field::new(
        "tasks",
        DataType::List(item(DataType::Utf8)),
        true,
    ));
    for feature in videos {
        let [chunk, file, from, to] = video_columns(feature);
        fields.extend([chunk, file].map(|name| Field::new(name, DataType::Int64, true)));
        fields.extend([from, to].map(|name| Field::new(name, DataType::Float64, true)));
    }
    Schema::new(fields)
}

/// The element of a list column.
pub(crate) fn item(data_type: DataType) -> Arc<Field> {
    Arc::new(Field::new_list_field(data_type, true))
}

/// A column of fixed-size lists of `width` numbers.
pub(crate) fn vector_field(name: &str, data_type: DataType, width: usize) -> Field {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "widths have two digits at most"
    )]
    let width = width as i32;
    Field::new(name, DataType::FixedSizeList(item(data_type), width), true)
}

// A JSON object whose order counts: cameras are numbered by it.
fn serialize_in_order<S: Serializer>(
    features: &[(String, Feature)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(features.len()))?;
    for (name, feature) in features {
        map.serialize_entry(name, feature)?;
    }
    map.end()
}

fn deserialize_in_order<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<(String, Feature)>, D::Error> {
    struct InOrder;
    impl<'de> Visitor<'de> for InOrder {
        type Value = Vec<(String, Feature)>;

        fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            formatter.write_str("an object of features")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut features = Vec::new();
            while let Some(entry) = map.next_entry()? {
                features.push(entry);
            }
            Ok(features)
        }
    }
    deserializer.deserialize_map(InOrder)
}
