//! One episode's frames of one camera on their way into a video file, through the system's ffmpeg.
//!
//! Raw RGB goes into the child's standard input; a thread drains its standard error, so that a full
//! pipe cannot block it. The file is `PATH.partial` until it is whole.

use std::{
    fs::{self, File},
    io::Write,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::JoinHandle,
};

use super::{
    CameraSpec, DatasetError,
    store::io_error,
    video::{VideoCodec, failed, program, reason_in, spawn, url},
};

/// A video that is being written beside its place. Dropped unfinished, it leaves nothing.
#[derive(Debug)]
pub(crate) struct Encoder {
    /// ffmpeg; it ends when its standard input is closed.
    child: Child,
    /// Collects what ffmpeg says; taken when the child has ended.
    errors: Option<JoinHandle<String>>,
    /// Where the whole file goes.
    path: PathBuf,
    /// Where it is until then; no reader looks at this suffix.
    partial: PathBuf,
    /// Set after the renaming; without it, dropping kills the child and removes the partial file.
    finished: bool,
}

/// The command that encodes raw RGB images from its standard input into the file `to`.
fn encode_raw(to: &Path, camera: &CameraSpec, fps: u32, codec: VideoCodec) -> Command {
    let mut command = program("ffmpeg");
    command
        .arg("-y")
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24"]);
    let size = format!("{}x{}", camera.width, camera.height);
    command.args(["-video_size", &size, "-framerate", &fps.to_string()]);
    command.args(["-i", "-"]).args(codec.options());
    command
        .args(["-pix_fmt", "yuv420p", "-f", "mp4"])
        .arg(url(to));
    command.stdin(Stdio::piped()).stdout(Stdio::null());
    // Ctrl-C on the terminal is for who records: what is begun here is finished.
    command.process_group(0);
    command
}

impl Encoder {
    /// Starts on the file `path`, in a folder that is made.
    pub(crate) fn start(
        path: &Path,
        camera: &CameraSpec,
        fps: u32,
        codec: VideoCodec,
    ) -> Result<Self, DatasetError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(io_error(folder))?;
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        let mut child = spawn(encode_raw(&partial, camera, fps, codec), path)?;
        let errors = child.stderr.take();
        let errors = errors.map(|errors| std::thread::spawn(move || reason_in(errors)));
        Ok(Self {
            child,
            errors,
            path: path.to_owned(),
            partial,
            finished: false,
        })
    }

    /// Adds a frame of RGB bytes.
    ///
    /// `rgb` is row-major, `3 * width * height` bytes, which the caller has checked; ffmpeg would
    /// cut another number of bytes into frames all the same. Blocks while the pipe is full, so
    /// recording is never ahead of the encoder by more than that.
    pub(crate) fn push(&mut self, rgb: &[u8]) -> Result<(), DatasetError> {
        let written = match self.child.stdin.as_mut() {
            Some(input) => input.write_all(rgb),
            None => Ok(()),
        };
        if written.is_ok() {
            return Ok(());
        }
        let reason = self.end().1;
        Err(failed(&self.path, format!("ffmpeg gave up: {reason}")))
    }

    /// Ends the video and puts it in its place, whole and durable. Waits for the encoder; then
    /// syncs the file, renames it and syncs the folder.
    pub(crate) fn finish(mut self) -> Result<(), DatasetError> {
        let (good, reason) = self.end();
        if !good {
            return Err(failed(&self.path, format!("ffmpeg failed: {reason}")));
        }
        let synced = File::open(&self.partial).and_then(|file| file.sync_all());
        synced.map_err(io_error(&self.partial))?;
        fs::rename(&self.partial, &self.path).map_err(io_error(&self.path))?;
        self.finished = true;
        let folder = self.path.parent().unwrap_or(Path::new("."));
        File::open(folder)
            .and_then(|folder| folder.sync_all())
            .map_err(io_error(folder))
    }

    /// Waits for the program: whether it ended well, and what it said.
    fn end(&mut self) -> (bool, String) {
        drop(self.child.stdin.take());
        let status = self.child.wait();
        let errors = self.errors.take().and_then(|errors| errors.join().ok());
        let good = status.is_ok_and(|status| status.success());
        (good, errors.unwrap_or_default())
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        if !self.finished {
            let _gone = self.child.kill();
            let _ended = self.child.wait();
            let _removed = fs::remove_file(&self.partial);
        }
    }
}
