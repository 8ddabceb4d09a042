//! Frames out of video files, through the system's ffmpeg and ffprobe (5.1 or newer), each as a
//! process of its own.
//!
//! Nothing is trusted but the frames' own times: a frame is the one that is shown when the dataset
//! says that it is.

use std::{
    io::Read,
    path::Path,
    process::{Child, Command, Stdio},
};

use super::DatasetError;

/// How far a frame's time may be from the dataset's, s; LeRobot's own tolerance.
const TIME_TOLERANCE_S: f64 = 1e-4;

/// Frames that a video file may have: eleven days at 25 a second.
const FRAMES_MAX: usize = 1 << 24;

/// What a program says of its failure that is passed on, bytes.
const REASON_MAX: u64 = 2000;

/// How frames are compressed into a video. Both lose: pictures come back close, not the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoCodec {
    /// H.264 by libx264 with rate factor 18, a key frame every second frame.
    H264,
    /// AV1 by SVT-AV1 with rate factor 30, a key frame every second frame: LeRobot's choice.
    Av1,
}

impl VideoCodec {
    /// Its name in `info.json`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::Av1 => "av1",
        }
    }

    /// The encoder's options.
    pub(super) const fn options(self) -> &'static [&'static str] {
        match self {
            Self::H264 => &["-c:v", "libx264", "-crf", "18", "-g", "2", "-bf", "0"],
            Self::Av1 => &[
                "-c:v",
                "libsvtav1",
                "-crf",
                "30",
                "-preset",
                "10",
                "-g",
                "2",
            ],
        }
    }
}

/// When a video's frames are shown, s, in order.
#[derive(Clone, Debug)]
pub(super) struct FrameTimes(Vec<f64>);

impl FrameTimes {
    /// Reads them from the file at `path`; decodes nothing.
    pub(super) fn read(path: &Path) -> Result<Self, DatasetError> {
        let mut command = program("ffprobe");
        command.args(["-select_streams", "v:0", "-show_entries", "packet=pts_time"]);
        command.args(["-of", "csv=print_section=0"]).arg(url(path));
        // A line is not longer than this.
        let listing = output(command, path, 32 * FRAMES_MAX)?;
        let listing = String::from_utf8_lossy(&listing);
        let mut times = Vec::new();
        for line in listing.lines() {
            let time = line.trim_end_matches(',').trim();
            if time.is_empty() {
                continue;
            }
            let time: f64 = time
                .parse()
                .map_err(|_| failed(path, format!("a frame is shown at {time:?}")))?;
            times.push(time);
        }
        // Packets come in the order of decoding.
        times.sort_by(f64::total_cmp);
        Ok(Self(times))
    }

    /// The number of the frame that is shown at `time_s`.
    pub(super) fn frame_at(&self, time_s: f64, path: &Path) -> Result<usize, DatasetError> {
        let after = self.0.partition_point(|&time| time < time_s);
        let near = [after.checked_sub(1), Some(after)];
        let place = near.into_iter().flatten().find(|&place| {
            let time = self.0.get(place);
            time.is_some_and(|time| (time - time_s).abs() <= TIME_TOLERANCE_S)
        });
        place.ok_or_else(|| {
            let end = self.0.last().copied().unwrap_or(f64::NAN);
            let frames = self.0.len();
            failed(
                path,
                format!(
                    "no frame is shown at {time_s:.6} s; it has {frames}, the last at {end:.6} s"
                ),
            )
        })
    }

    /// Frames in the file.
    pub(super) const fn len(&self) -> usize {
        self.0.len()
    }

    /// `count` frames from frame `first` on as RGB bytes, `width` by `height` each, one after
    /// another.
    pub(super) fn decode(
        &self,
        path: &Path,
        [first, count]: [usize; 2],
        [width, height]: [u32; 2],
    ) -> Result<Vec<u8>, DatasetError> {
        let time = |place: usize| self.0.get(place).copied().unwrap_or(0.0);
        // Between this frame and the one before: what is shown earlier is dropped.
        let from = match first.checked_sub(1) {
            Some(before) => f64::midpoint(time(before), time(first)),
            None => time(first) - 1.0,
        };
        let expected = 3 * width as usize * height as usize * count;
        let bytes = output(decode_raw(path, from, count), path, expected)?;
        if bytes.len() != expected {
            let found = bytes.len();
            let what = format!(
                "{count} frames of {width} x {height} from frame {first} on are {found} bytes, expected {expected}"
            );
            return Err(failed(path, what));
        }
        Ok(bytes)
    }
}

/// The command that writes `count` frames of the video `path` as raw RGB to its standard output,
/// from the first one shown at `from_s` or later on.
fn decode_raw(path: &Path, from_s: f64, count: usize) -> Command {
    let mut command = program("ffmpeg");
    command.args(["-nostdin", "-threads", "1"]);
    command.args(["-seek_timestamp", "1", "-ss", &format!("{from_s:.6}")]);
    command.arg("-i").arg(url(path)).args(["-map", "0:v:0"]);
    command.args(["-frames:v", &count.to_string()]);
    command.args(["-fps_mode", "passthrough", "-f", "rawvideo"]);
    command.args(["-pix_fmt", "rgb24", "-"]);
    command
}

/// One of ffmpeg's programs, quiet and without a network.
pub(super) fn program(name: &str) -> Command {
    let mut command = Command::new(name);
    command.args(["-hide_banner", "-v", "error"]);
    if name == "ffprobe" {
        command.args(["-protocol_whitelist", "file"]);
    }
    command.stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// The file at `path` so that no part of its name can mean anything else.
pub(super) fn url(path: &Path) -> std::ffi::OsString {
    let mut url = std::ffi::OsString::from("file:");
    url.push(path);
    url
}

/// Starts `command`, which works on `path`.
pub(super) fn spawn(mut command: Command, path: &Path) -> Result<Child, DatasetError> {
    command.spawn().map_err(|source| {
        let name = command.get_program().to_string_lossy().into_owned();
        if source.kind() == std::io::ErrorKind::NotFound {
            let what = format!("{name} is not installed; frames in video need ffmpeg 5.1 or newer");
            return failed(path, what);
        }
        failed(path, format!("{name} cannot be started: {source}"))
    })
}

/// What `command` writes, if it ends well; not more than `limit` bytes are kept.
fn output(command: Command, path: &Path, limit: usize) -> Result<Vec<u8>, DatasetError> {
    let mut child = spawn(command, path)?;
    let (out, errors) = (child.stdout.take(), child.stderr.take());
    let mut bytes = Vec::new();
    let (read, reason) = std::thread::scope(|scope| {
        let reason = scope.spawn(|| errors.map(reason_in).unwrap_or_default());
        // One byte more than allowed shows that there is more; then the pipe is closed, and the
        // program ends.
        let limit = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
        let read = out.map_or(Ok(0), |out| out.take(limit).read_to_end(&mut bytes));
        (read, reason.join().unwrap_or_default())
    });
    let status = child.wait();
    read.map_err(|error| failed(path, format!("reading its frames: {error}")))?;
    match status {
        _ if bytes.len() > limit => Err(failed(path, format!("more than {limit} bytes"))),
        Ok(status) if status.success() => Ok(bytes),
        Ok(status) => Err(failed(path, format!("{status}: {reason}"))),
        Err(error) => Err(failed(path, error.to_string())),
    }
}

/// The beginning of what a program says, on one line; the rest is read and dropped, so that it does
/// not wait.
pub(super) fn reason_in(mut errors: impl Read) -> String {
    let mut text = Vec::new();
    let _cut = errors.by_ref().take(REASON_MAX).read_to_end(&mut text);
    let _dropped = std::io::copy(&mut errors, &mut std::io::sink());
    let text = String::from_utf8_lossy(&text);
    text.lines().map(str::trim).collect::<Vec<_>>().join("; ")
}

/// The error that `what` is wrong with the video at `path`.
pub(super) fn failed(path: &Path, what: String) -> DatasetError {
    DatasetError::Video {
        path: path.to_owned(),
        what,
    }
}
