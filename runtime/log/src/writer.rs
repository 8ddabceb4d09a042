//! Writes records into an MCAP file; runs on the writer thread.
//!
//! Log time and publish time of a message are the same: that of its tick, frame or event, ns since
//! the run began. Sequence numbers count by channel from 0. The file's chunks are closed every 250
//! ms of log time or at 1 MiB, compressed, and written in one piece: a crash of the process loses
//! what is in the queues and about the last 250 ms.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use hal::{Pose, TimeNs};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapResult, WriteOptions, Writer};
use prost::{EncodeError, Message};
use serde::Serialize;

use super::buses::BusesRecord;
use super::contents::ContentHash;
use super::frames::{self, RCM_FRAMES, measured_tip};
use super::header::{self, Closing, RunHeader};
use super::item::{ChunkItem, TickItem};
use super::joints::JointMessages;
use super::json::{
    ChunkMessage, ChunkRef, ErrorMessage, OperatorMessage, TickMessage, TimingMessage,
};
use super::record::{ArmRecord, TickRecord};
use super::safety::SafetyMessage;
use super::scene::SceneRecord;
use super::snapshot::SnapshotMessage;
use super::topic::{self, Schema, TOPIC_COUNT, Topic};
use super::{Level, camera};

/// Ticks from one message of frames to the next: people look at them.
const FRAMES_EVERY_TICKS: u64 = 40;

/// A crash loses at most this much log time.
const FLUSH_NS: u64 = 250_000_000;

/// Bytes after which a chunk of the file is closed before its time; only cameras reach it.
const FILE_CHUNK_BYTES: u64 = 1 << 20;

/// How the file is written: chunks whole, compressed by the thread that writes.
fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("")
        .library(concat!("trocar ", env!("CARGO_PKG_VERSION")))
        .chunk_size(Some(FILE_CHUNK_BYTES))
        // A chunk reaches the file whole or not at all, so that a cut file ends between two of
        // them.
        .disable_seeking(true)
        .compression_level(1)
        .compression_threads(0)
}

/// Writes the run's header; what was written.
fn write_header<W: Write + Seek>(
    writer: &mut Writer<W>,
    run: &RunHeader,
) -> McapResult<ContentHash> {
    let mut contents = ContentHash::default();
    for (name, metadata) in run.to_metadata() {
        contents.metadata(name, &metadata);
        let name = name.to_owned();
        writer.write_metadata(&Metadata { name, metadata })?;
    }
    Ok(contents)
}

/// The open file.
pub(super) struct LogWriter<W: Write + Seek> {
    writer: Writer<W>,
    /// Each arm's channels; another arm than the first has them from its first message on.
    channels: Vec<[u16; TOPIC_COUNT]>,
    /// By name; added with each camera's first frame.
    cameras: BTreeMap<String, camera::Channels>,
    /// The next sequence number of each channel.
    sequences: BTreeMap<u16, u32>,
    /// The name of each channel.
    names: BTreeMap<u16, String>,
    /// Over all that was written up to now.
    contents: ContentHash,
    joints: JointMessages,
    /// Where the arms' remote centres are, if the run's limits say so.
    rcms_in_scene: Vec<Pose>,
    /// The message that is written, encoded; reused.
    buffer: Vec<u8>,
    /// Of the tick before, for the period in `/timing`; 0 before the first.
    previous_now: TimeNs,
    /// Of the tick up to which the file is whole.
    flushed_at: TimeNs,
}

impl<W: Write + Seek> LogWriter<W> {
    /// Starts a file and writes the run's header into it.
    pub(super) fn new(sink: W, run: &RunHeader) -> McapResult<Self> {
        let mut writer = options().create(sink)?;
        let contents = write_header(&mut writer, run)?;
        let channels = vec![topic::add_channels(&mut writer, 0)?];
        let mut names = BTreeMap::new();
        topic::name_channels(&channels, &mut names);
        writer.flush()?;
        Ok(Self {
            writer,
            channels,
            cameras: BTreeMap::new(),
            sequences: BTreeMap::new(),
            names,
            contents,
            joints: JointMessages::new(),
            rcms_in_scene: run.rcms_in_scene(),
            buffer: Vec::new(),
            previous_now: TimeNs(0),
            flushed_at: TimeNs(0),
        })
    }

    /// Writes all messages of one tick. The first arm comes last: its tick message says that the
    /// tick is complete.
    pub(super) fn tick(&mut self, item: &TickItem) -> McapResult<()> {
        let tick = &item.tick;
        if let Some(second) = &tick.arms.second {
            self.arm(1, tick, second)?;
            self.rest(1, item, second)?;
        }
        self.arm(0, tick, &tick.arms.first)?;
        let timing = TimingMessage::new(tick, self.previous_now);
        self.json(Topic::Timing, 0, tick.now, &timing)?;
        if tick.tick.is_multiple_of(FRAMES_EVERY_TICKS) {
            let transforms = frames::of_arms(tick, &self.rcms_in_scene);
            if !transforms.transforms.is_empty() {
                self.protobuf(Topic::Transforms, 0, tick.now, |_, buffer| {
                    transforms.encode(buffer)
                })?;
            }
        }
        self.rest(0, item, &tick.arms.first)?;
        self.previous_now = tick.now;
        if tick.now.since(self.flushed_at) >= FLUSH_NS {
            self.flush(tick.now)?;
        }
        Ok(())
    }

    /// Brings everything up to the tick at `now` into the file.
    pub(super) fn flush(&mut self, now: TimeNs) -> McapResult<()> {
        if !self.has_flushed(now) {
            self.flushed_at = now;
            self.writer.flush()?;
        }
        Ok(())
    }

    /// Goes on with the run where the file of `before` ends, so that the first tick has the period
    /// of any other.
    pub(super) const fn go_on_from(&mut self, before: &Self) {
        self.previous_now = before.previous_now;
    }

    /// Whether everything up to the tick at `now` is in the file.
    pub(super) fn has_flushed(&self, now: TimeNs) -> bool {
        self.flushed_at == now
    }

    /// Writes measurement, command and safety report of the arm `index`.
    fn arm(&mut self, index: usize, tick: &TickRecord, arm: &ArmRecord) -> McapResult<()> {
        let measured = arm.measured.as_ref().ok();
        self.joints.set_measured(measured);
        self.joints.set_command(&arm.command);
        if let Some(state) = measured {
            self.protobuf(Topic::MeasuredJs, index, tick.now, |joints, buffer| {
                joints.measured.encode(buffer)
            })?;
            if state.is_finite() {
                let tip = measured_tip(RCM_FRAMES[index], state);
                self.protobuf(Topic::MeasuredCp, index, tick.now, |_, buffer| {
                    tip.encode(buffer)
                })?;
            }
        }
        self.protobuf(Topic::Jaw, index, tick.now, |joints, buffer| {
            joints.jaw.encode(buffer)
        })?;
        self.protobuf(Topic::SetpointJs, index, tick.now, |joints, buffer| {
            joints.setpoint.encode(buffer)
        })?;
        let safety = SafetyMessage::new(tick.tick, &arm.report);
        self.json(Topic::Safety, index, tick.now, &safety)
    }

    /// Writes the other inputs of the controller for the arm `index`.
    fn rest(&mut self, index: usize, item: &TickItem, arm: &ArmRecord) -> McapResult<()> {
        let record = item.chunk_records.get(index).copied().flatten();
        let rest = TickMessage {
            record: item.record,
            tick: item.tick.tick,
            now_ns: item.tick.now.0,
            error: arm.measured.err().map(ErrorMessage::from),
            operator: arm.operator.map(OperatorMessage::from),
            chunk: arm
                .chunk_sequence
                .map(|sequence| ChunkRef { sequence, record }),
            enabled: arm.command.enabled,
        };
        self.json(Topic::Tick, index, item.tick.now, &rest)
    }

    /// Writes a chunk that the controller was given at `now`, before the tick that names it.
    pub(super) fn chunk(&mut self, item: &ChunkItem, now: TimeNs) -> McapResult<()> {
        let message = ChunkMessage::new(item.record, &item.chunk);
        self.json(Topic::Chunk, item.arm, now, &message)
    }

    /// Writes a line of text.
    pub(super) fn event(&mut self, at: TimeNs, level: Level, text: String) -> McapResult<()> {
        let log = level.line(at, text);
        self.protobuf(Topic::Events, 0, at, |_, buffer| log.encode(buffer))
    }

    /// Writes where everything in the scene is, and how its task stands.
    pub(super) fn scene(&mut self, at: TimeNs, scene: &SceneRecord) -> McapResult<()> {
        self.json(Topic::Task, 0, at, scene)
    }

    /// Writes the controller's state after the tick at `now`.
    pub(super) fn snapshot(&mut self, now: TimeNs, snapshot: &SnapshotMessage) -> McapResult<()> {
        self.json(Topic::Snapshot, 0, now, snapshot)
    }

    /// Writes how the buses are.
    pub(super) fn buses(&mut self, at: TimeNs, buses: &BusesRecord) -> McapResult<()> {
        self.json(Topic::Buses, 0, at, buses)
    }

    /// Writes a camera's image, lens and pose.
    pub(super) fn frame(
        &mut self,
        name: &str,
        at: TimeNs,
        frame: &camera::Encoded,
    ) -> McapResult<()> {
        let channels = self.camera(name)?;
        self.put_message(channels.lens, at, &frame.lens)?;
        self.put_message(channels.pose, at, &frame.pose)?;
        self.protobuf(Topic::Transforms, 0, at, |_, buffer| {
            frame.place.encode(buffer)
        })?;
        self.put_message(channels.image, at, &frame.image)
    }

    /// The channels of the camera `name`, added to the file with its first frame.
    fn camera(&mut self, name: &str) -> McapResult<camera::Channels> {
        if let Some(&known) = self.cameras.get(name) {
            return Ok(known);
        }
        let mut add = |topic: String, message| {
            let schema = Schema::Protobuf(message);
            let channel = topic::add_channel(&mut self.writer, &topic, schema)?;
            self.names.insert(channel, topic);
            McapResult::Ok(channel)
        };
        let new = camera::Channels {
            image: add(topic::image_topic(name), "foxglove.CompressedImage")?,
            lens: add(topic::lens_topic(name), "foxglove.CameraCalibration")?,
            pose: add(topic::pose_topic(name), "foxglove.PoseInFrame")?,
        };
        self.cameras.insert(name.to_owned(), new);
        Ok(new)
    }

    /// For channels that are not a [`Topic`]'s: those of cameras.
    fn put_message(&mut self, channel: u16, at: TimeNs, message: &impl Message) -> McapResult<()> {
        self.buffer.clear();
        message
            .encode(&mut self.buffer)
            .map_err(std::io::Error::from)?;
        self.put(channel, at)
    }

    /// Writes the outcome and closes the file.
    ///
    /// The hash over the contents covers the closing record too, but for itself.
    pub(super) fn finish(mut self, closing: Closing) -> McapResult<()> {
        let contents = header::contents_after(&self.contents, &closing.to_metadata());
        let metadata = Closing {
            contents: Some(contents),
            ..closing
        }
        .to_metadata();
        self.writer.write_metadata(&Metadata {
            name: header::OUTCOME.to_owned(),
            metadata,
        })?;
        self.writer.finish()?;
        self.writer.into_inner().flush()?;
        Ok(())
    }

    /// Encodes with what `encode` is given, the arm's joint messages, and writes to the arm's
    /// channel of `topic`.
    fn protobuf(
        &mut self,
        topic: Topic,
        arm: usize,
        now: TimeNs,
        encode: impl FnOnce(&JointMessages, &mut Vec<u8>) -> Result<(), EncodeError>,
    ) -> McapResult<()> {
        self.buffer.clear();
        encode(&self.joints, &mut self.buffer).map_err(std::io::Error::from)?;
        let channel = self.channel(topic, arm)?;
        self.put(channel, now)
    }

    /// As `protobuf`, in JSON.
    fn json(
        &mut self,
        topic: Topic,
        arm: usize,
        now: TimeNs,
        message: &impl Serialize,
    ) -> McapResult<()> {
        self.buffer.clear();
        serde_json::to_writer(&mut self.buffer, message).map_err(std::io::Error::from)?;
        let channel = self.channel(topic, arm)?;
        self.put(channel, now)
    }

    /// The channel of an arm's topic, added to the file with the arm's first message.
    fn channel(&mut self, topic: Topic, arm: usize) -> McapResult<u16> {
        while self.channels.len() <= arm {
            let channels = topic::add_channels(&mut self.writer, self.channels.len())?;
            self.channels.push(channels);
            topic::name_channels(&self.channels, &mut self.names);
        }
        Ok(self.channels[arm][topic as usize])
    }

    /// Writes the message in the buffer and adds it to the hash of the contents.
    fn put(&mut self, channel_id: u16, now: TimeNs) -> McapResult<()> {
        let sequence = self.sequences.entry(channel_id).or_insert(0);
        let header = MessageHeader {
            channel_id,
            sequence: *sequence,
            log_time: now.0,
            publish_time: now.0,
        };
        *sequence = sequence.wrapping_add(1);
        let name = &self.names[&channel_id];
        self.contents.message(name, &header, &self.buffer);
        self.writer.write_to_known_channel(&header, &self.buffer)
    }
}
