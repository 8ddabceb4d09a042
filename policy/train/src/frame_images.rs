//! All images of a dataset, decoded once: on the training device, or in the host's memory and sent
//! ahead of each step.
//!
//! Each image is decoded once, whatever the number of steps, so the bytes must fit somewhere: a
//! dataset of 10 000 frames of two cameras at 256 x 256 is 3.9 GB.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use tch::{Device, Kind, TchError, Tensor};

use super::TrainError;
use super::transfer::send;
use hal::count::count_u32;
use trocar_data::dataset::Dataset;
use trocar_nets::act::ActConfig;
use trocar_nets::dimension::{dimension, length};
use trocar_nets::images::{area_average, shrink_factor};

/// Bytes that are decoded before they go to the device.
const BLOCK_BYTES: usize = 1 << 28;

/// The images of every frame, `(cameras, height, width, 3)` bytes each.
pub(super) enum FrameImages {
    /// `(frames, cameras, height, width, 3)` on the training device.
    Resident(Tensor),
    /// In the host's memory, for what the device can't hold; a thread gathers the next batch while
    /// a step is computed.
    Streamed(Stream),
}

/// Sizes of a frame's images.
#[derive(Clone, Copy, Debug)]
struct Shape {
    cameras: usize,
    high: i64,
    wide: i64,
}

impl Shape {
    /// Bytes of one camera's image, three a pixel.
    fn image_bytes(self) -> usize {
        length(3 * self.high * self.wide)
    }

    /// Bytes of all cameras' images of a frame.
    fn frame_bytes(self) -> usize {
        self.image_bytes() * self.cameras
    }

    /// The tensor's shape `(frames, cameras, height, width, 3)`.
    fn of(self, frames: usize) -> [i64; 5] {
        let (frames, cameras) = (dimension(frames), dimension(self.cameras));
        [frames, cameras, self.high, self.wide, 3]
    }
}

impl FrameImages {
    /// Decodes all images of `dataset` at the network's size, `threads` at a time.
    ///
    /// They stay on `device`; in the host's memory if `on_host` says so or the device has no room.
    /// `on_read` hears how many frames are done.
    pub(super) fn new(
        dataset: &Dataset,
        config: &ActConfig,
        threads: usize,
        (device, on_host): (Device, bool),
        on_read: &mut dyn FnMut(usize),
    ) -> Result<Self, TrainError> {
        let shape = Shape {
            cameras: dataset.camera_names().len(),
            high: config.image_height,
            wide: config.image_width,
        };
        let all = shape.of(dataset.len());
        let room = if on_host {
            None
        } else {
            match Tensor::f_empty(all, (Kind::Uint8, device)) {
                Ok(room) => Some(room),
                Err(error) if device == Device::Cpu => return Err(error.into()),
                Err(_no_room) => None,
            }
        };
        let mut kept = Vec::new();
        let block = (BLOCK_BYTES / shape.frame_bytes().max(1)).max(threads.max(1));
        let mut start = 0;
        while start < dataset.len() {
            let frames = start..dataset.len().min(start + block);
            let bytes = decode(dataset, shape, threads, frames.clone())?;
            match &room {
                Some(room) => {
                    let part =
                        Tensor::f_from_data_size(&bytes, &shape.of(frames.len()), Kind::Uint8)?;
                    let count = part.size()[0];
                    room.f_narrow(0, dimension(start), count)?.f_copy_(&part)?;
                }
                None => kept.extend_from_slice(&bytes),
            }
            start = frames.end;
            on_read(start);
        }
        Ok(match room {
            Some(images) => Self::Resident(images),
            None => Self::Streamed(Stream::new(kept, shape, device)),
        })
    }

    /// Announces the frames of a later [`Self::batch`], to be prefetched.
    pub(super) fn announce(&self, frames: &[usize]) {
        if let Self::Streamed(stream) = self {
            stream.announce(frames);
        }
    }

    /// The images of `frames` on their way to the training device, if they are not there.
    pub(super) fn sent(&self, frames: &[usize]) -> Result<Option<Tensor>, TchError> {
        match self {
            Self::Resident(_) => Ok(None),
            Self::Streamed(stream) => stream.batch(frames).map(Some),
        }
    }

    /// The images of the frames `indices` on the training device, or those that were
    /// [`Self::sent`].
    pub(super) fn batch(
        &self,
        indices: &Tensor,
        sent: Option<&Tensor>,
    ) -> Result<Tensor, TchError> {
        match (self, sent) {
            (_, Some(sent)) => Ok(sent.shallow_clone()),
            (Self::Resident(images), None) => images.f_index_select(0, indices),
            (Self::Streamed(_), None) => Err(TchError::Torch(
                "no images were sent to the device".to_owned(),
            )),
        }
    }
}

/// Images in the host's memory, and the thread that gathers batches of them.
pub(super) struct Stream {
    /// All images, `(frames, cameras, height, width, 3)`.
    bytes: Arc<Vec<u8>>,
    shape: Shape,
    device: Device,
    /// Orders to the thread; none while this is dropped.
    wanted: Option<Sender<Vec<usize>>>,
    /// Its batches, in the order of the orders.
    gathered: Receiver<Vec<u8>>,
    /// What is being gathered, in order.
    announced: RefCell<VecDeque<Vec<usize>>>,
    /// Ends when `wanted` is dropped.
    thread: Option<JoinHandle<()>>,
}

impl Stream {
    fn new(bytes: Vec<u8>, shape: Shape, device: Device) -> Self {
        let bytes = Arc::new(bytes);
        let (wanted, orders) = channel::<Vec<usize>>();
        let (done, gathered) = channel();
        let source = Arc::clone(&bytes);
        let thread = std::thread::spawn(move || {
            for frames in orders {
                if done.send(gather(&source, shape, &frames)).is_err() {
                    return;
                }
            }
        });
        Self {
            bytes,
            shape,
            device,
            wanted: Some(wanted),
            gathered,
            announced: RefCell::new(VecDeque::new()),
            thread: Some(thread),
        }
    }

    /// Has a batch gathered.
    fn announce(&self, frames: &[usize]) {
        if let Some(wanted) = &self.wanted
            && wanted.send(frames.to_vec()).is_ok()
        {
            self.announced.borrow_mut().push_back(frames.to_vec());
        }
    }

    /// The batch that was announced first, if it is of `frames`; else they are gathered now.
    fn batch(&self, frames: &[usize]) -> Result<Tensor, TchError> {
        let mut announced = self.announced.borrow_mut();
        let ahead = if announced.front().is_some_and(|next| next == frames) {
            announced.pop_front();
            self.gathered.recv().ok()
        } else {
            None
        };
        let bytes = ahead.unwrap_or_else(|| gather(&self.bytes, self.shape, frames));
        let shape = self.shape.of(frames.len());
        let batch = Tensor::f_from_data_size(&bytes, &shape, Kind::Uint8)?;
        send(&batch, self.device)
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // Without a sender the thread ends.
        self.wanted = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The images of `frames`, in that order, out of those of all.
fn gather(bytes: &[u8], shape: Shape, frames: &[usize]) -> Vec<u8> {
    let size = shape.frame_bytes();
    let mut batch = Vec::with_capacity(frames.len() * size);
    for frame in frames {
        batch.extend_from_slice(&bytes[frame * size..(frame + 1) * size]);
    }
    batch
}

/// The images of `frames`, `threads` at a time; the order is that of the frames whatever the
/// threads do.
fn decode(
    dataset: &Dataset,
    shape: Shape,
    threads: usize,
    frames: Range<usize>,
) -> Result<Vec<u8>, TrainError> {
    let mut bytes = vec![0_u8; shape.frame_bytes() * frames.len()];
    let share = frames.len().div_ceil(threads.max(1)).max(1);
    std::thread::scope(|scope| {
        let workers: Vec<_> = bytes
            .chunks_mut(share * shape.frame_bytes())
            .enumerate()
            .map(|(worker, part)| {
                let first = frames.start + worker * share;
                scope.spawn(move || {
                    for (index, image) in part.chunks_mut(shape.image_bytes()).enumerate() {
                        let (frame, camera) =
                            (first + index / shape.cameras, index % shape.cameras);
                        read_image(dataset, frame, camera, [shape.wide, shape.high], image)?;
                    }
                    Ok::<(), TrainError>(())
                })
            })
            .collect();
        for worker in workers {
            worker
                .join()
                .map_err(|_| TrainError::Dataset("a decoding thread failed".to_owned()))??;
        }
        Ok::<(), TrainError>(())
    })?;
    Ok(bytes)
}

/// Decodes an image into `into`, averaged down to `[width, height]`.
fn read_image(
    dataset: &Dataset,
    frame: usize,
    camera: usize,
    [wide, high]: [i64; 2],
    into: &mut [u8],
) -> Result<(), TrainError> {
    let image = dataset.image_rgb(frame, camera)?;
    let side = |pixels: i64| count_u32(length(pixels));
    let factor = shrink_factor(image.width(), image.height(), side(wide), side(high))?;
    into.copy_from_slice(&area_average(image.as_raw(), image.width(), factor));
    Ok(())
}
