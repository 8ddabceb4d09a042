//! Camera frames through shared memory: the renderer fills the buffer that the policy reads.
//!
//! A frame is one slice of 32-bit words: depth, one word a pixel; then colour, 3 bytes a pixel;
//! then instance ids, one byte a pixel. What describes it travels in the sample's header.

use core::fmt;
use std::sync::Arc;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::port::{LoanError, ReceiveError};
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;

use super::events::Bell;
use super::limits::{LOANED_MAX, Service, UNREAD};
use super::message::{pose, xyzw};
use super::{TopicError, TopicNode};
use hal::camera::{CameraFrame, FrameRef, Intrinsics};
use hal::{Pose, TimeNs};

/// Words of data a pixel: 4 bytes of depth, 3 of colour, 1 of instance id.
const WORDS_PER_PIXEL: usize = 2;

/// What describes a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/frame_header/2")]
pub struct FrameHeader {
    /// When it was exposed, by the system's `CLOCK_MONOTONIC`, ns, which all processes of a machine
    /// share (slowed down alike in slow motion).
    pub stamp: TimeNs,
    /// Count of frames from this camera.
    pub sequence: u64,
    /// The lens with its distortion, which also gives the size.
    pub intrinsics: Intrinsics,
    /// Camera position in the scene frame, metres.
    pub position_m: [f64; 3],
    /// Camera rotation in the scene frame, unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

impl FrameHeader {
    /// The header of a frame taken from `camera_in_scene`.
    #[must_use]
    pub fn new(
        stamp: TimeNs,
        sequence: u64,
        intrinsics: Intrinsics,
        camera_in_scene: &Pose,
    ) -> Self {
        let position_m = camera_in_scene.translation.vector.into();
        Self {
            stamp,
            sequence,
            intrinsics,
            position_m,
            rotation_xyzw: xyzw(camera_in_scene),
        }
    }

    /// Camera pose in the scene frame: x right, y down, z along the view.
    #[must_use]
    pub fn camera_in_scene(&self) -> Pose {
        pose(self.position_m, self.rotation_xyzw)
    }
}

/// Frames of one camera; only its constructors are of interest.
#[derive(Debug)]
pub struct CameraTopic;

impl CameraTopic {
    /// The only writer of `camera` (`psm1/endoscope`), for frames of up to `pixels_max` pixels.
    ///
    /// Reserves 88 bytes of shared memory a pixel: 23 MB for 512 by 512.
    ///
    /// # Errors
    /// [`TopicError`]; in particular [`TopicError::SharedMemoryTooSmall`].
    pub fn publisher(
        node: &TopicNode,
        camera: &str,
        pixels_max: usize,
    ) -> Result<FramePublisher, TopicError> {
        let topic = node.service_name(&format!("{camera}/frame"))?;
        let service = node.open::<[f32], FrameHeader>(&topic, UNREAD)?;
        let words_max = pixels_max * WORDS_PER_PIXEL;
        let create = || {
            service
                .publisher_builder()
                .max_loaned_samples(LOANED_MAX)
                .initial_max_slice_len(words_max)
                .create()
        };
        let bytes = words_max * size_of::<f32>();
        let raw = node.create_publisher(&topic, (bytes, UNREAD), create)?;
        Ok(FramePublisher {
            raw,
            topic,
            pixels_max,
            bell: node.bell(),
        })
    }

    /// A reader of `camera`; it may come before the writer.
    ///
    /// # Errors
    /// [`TopicError`].
    pub fn subscriber(node: &TopicNode, camera: &str) -> Result<FrameSubscriber, TopicError> {
        let topic = node.service_name(&format!("{camera}/frame"))?;
        let service = node.open::<[f32], FrameHeader>(&topic, UNREAD)?;
        let raw = node.create_subscriber(&topic, || service.subscriber_builder().create())?;
        Ok(FrameSubscriber { raw, topic })
    }
}

/// Writes the frames of one camera.
#[derive(Debug)]
pub struct FramePublisher {
    raw: Publisher<Service, [f32], FrameHeader>,
    topic: String,
    pixels_max: usize,
    bell: Arc<Bell>,
}

impl FramePublisher {
    /// Publishes one frame that `fill` writes in place: colour (3 bytes a pixel), depth (m),
    /// instance ids.
    ///
    /// The buffers hold an older frame when `fill` gets them, so it writes every pixel. The number
    /// of readers reached.
    ///
    /// # Errors
    /// [`TopicError::FrameTooLarge`], [`TopicError::Transport`].
    pub fn publish_with(
        &mut self,
        header: &FrameHeader,
        fill: impl FnOnce(&mut [u8], &mut [f32], &mut [u8]),
    ) -> Result<usize, TopicError> {
        let mut loan = self.loan(header)?;
        let (colour, depth_m, instance) = loan.planes();
        fill(colour, depth_m, instance);
        loan.send()
    }

    /// Publishes a copy of `frame`; for those who have one already.
    ///
    /// # Errors
    /// [`TopicError::FrameShape`] if its planes do not fit its intrinsics, and as
    /// [`Self::publish_with`].
    pub fn publish(&mut self, frame: &CameraFrame) -> Result<usize, TopicError> {
        let pixels = frame.intrinsics.pixel_count();
        let planes = [
            frame.colour.len(),
            frame.depth_m.len(),
            frame.instance.len(),
        ];
        if planes != [3 * pixels, pixels, pixels] {
            return Err(frame_shape(
                &self.topic,
                &frame.intrinsics,
                frame.depth_m.len(),
            ));
        }
        let (lens, place) = (frame.intrinsics, &frame.camera_in_scene);
        let header = FrameHeader::new(frame.stamp, frame.sequence, lens, place);
        self.publish_with(&header, |colour, depth_m, instance| {
            colour.copy_from_slice(&frame.colour);
            depth_m.copy_from_slice(&frame.depth_m);
            instance.copy_from_slice(&frame.instance);
        })
    }

    /// A buffer in shared memory for one frame, to be filled and sent, or dropped unsent.
    ///
    /// # Errors
    /// [`TopicError::FrameTooLarge`], [`TopicError::TooManyHeld`] while another loan is out.
    pub fn loan(&self, header: &FrameHeader) -> Result<FrameLoan, TopicError> {
        let pixels = header.intrinsics.pixel_count();
        if pixels > self.pixels_max {
            let topic = self.topic.clone();
            return Err(TopicError::FrameTooLarge {
                topic,
                capacity: self.pixels_max,
                pixels,
            });
        }
        let mut sample = self
            .raw
            .loan_slice_uninit(pixels * WORDS_PER_PIXEL)
            .map_err(|error| match error {
                LoanError::ExceedsMaxLoans => TopicError::TooManyHeld {
                    topic: self.topic.clone(),
                },
                LoanError::OutOfMemory
                | LoanError::ExceedsMaxLoanSize
                | LoanError::InternalFailure => {
                    TopicError::transport(&self.topic, "loaning a frame", &error)
                }
            })?;
        *sample.user_header_mut() = *header;
        #[expect(
            unsafe_code,
            reason = "clearing 2 MiB that the renderer overwrites would cost more than the hand-over"
        )]
        // SAFETY: the words lie in a shared memory file that the kernel, and the transport once
        // more, filled with zeros when it was made; since then only frames were written. Every bit
        // pattern is an f32.
        let sample = unsafe { sample.assume_init() };
        Ok(FrameLoan {
            sample,
            topic: self.topic.clone(),
            pixels,
            bell: Arc::clone(&self.bell),
        })
    }

    /// Hands the newest frame to readers that have come since.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn keep_alive(&self) -> Result<(), TopicError> {
        self.raw
            .update_connections()
            .map_err(|error| TopicError::transport(&self.topic, "connecting", &error))
    }
}

/// A frame's buffer in shared memory while it is being filled.
#[derive(Debug)]
pub struct FrameLoan {
    sample: SampleMut<Service, [f32], FrameHeader>,
    topic: String,
    pixels: usize,
    bell: Arc<Bell>,
}

impl FrameLoan {
    /// Colour (3 bytes a pixel), depth (m) and instance ids, row-major from the top left; an older
    /// frame until written.
    pub fn planes(&mut self) -> (&mut [u8], &mut [f32], &mut [u8]) {
        let (depth_m, rest) = self.sample.payload_mut().split_at_mut(self.pixels);
        let (colour, instance) = bytemuck::cast_slice_mut(rest).split_at_mut(3 * self.pixels);
        (colour, depth_m, instance)
    }

    /// Publishes the frame and wakes who waits; the number of readers reached.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn send(self) -> Result<usize, TopicError> {
        let reached = self.sample.send();
        let reached = reached
            .map_err(|error| TopicError::transport(&self.topic, "publishing a frame", &error))?;
        self.bell.ring();
        Ok(reached)
    }
}

/// Reads the frames of one camera.
#[derive(Debug)]
pub struct FrameSubscriber {
    raw: Subscriber<Service, [f32], FrameHeader>,
    topic: String,
}

impl FrameSubscriber {
    /// The newest frame, if one has come since the last call. One earlier view may still be held.
    ///
    /// # Errors
    /// [`TopicError::FrameShape`] for a frame that contradicts its header,
    /// [`TopicError::TooManyHeld`], [`TopicError::Transport`].
    pub fn newest(&mut self) -> Result<Option<FrameView>, TopicError> {
        let mut newest = None;
        loop {
            let waiting = self.raw.has_samples();
            if !waiting
                .map_err(|error| TopicError::transport(&self.topic, "receiving a frame", &error))?
            {
                break;
            }
            // Given back before the next is taken: a publisher that was replaced may have left one
            // more.
            drop(newest.take());
            newest = self.raw.receive().map_err(|error| match error {
                ReceiveError::ExceedsMaxBorrows => TopicError::TooManyHeld {
                    topic: self.topic.clone(),
                },
                ReceiveError::ConnectionFailure(_) => {
                    TopicError::transport(&self.topic, "receiving a frame", &error)
                }
            })?;
        }
        newest.map(|sample| self.view(sample)).transpose()
    }

    fn view(&self, sample: Sample<Service, [f32], FrameHeader>) -> Result<FrameView, TopicError> {
        let lens = sample.user_header().intrinsics;
        let words = sample.payload().len();
        let pixels = u64::from(lens.width) * u64::from(lens.height);
        if u64::try_from(words).ok() != pixels.checked_mul(WORDS_PER_PIXEL as u64) {
            return Err(frame_shape(&self.topic, &lens, words));
        }
        Ok(FrameView {
            pixels: words / WORDS_PER_PIXEL,
            sample,
        })
    }
}

fn frame_shape(topic: &str, lens: &Intrinsics, words: usize) -> TopicError {
    TopicError::FrameShape {
        topic: topic.to_owned(),
        width: lens.width,
        height: lens.height,
        words,
    }
}

/// A received frame, read where the writer put it. Its buffer is not reused before the view is
/// dropped.
pub struct FrameView {
    sample: Sample<Service, [f32], FrameHeader>,
    pixels: usize,
}

impl FrameView {
    /// What describes the frame.
    #[must_use]
    pub fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }

    /// sRGB bytes, 3 a pixel, row-major from the top left.
    #[must_use]
    pub fn colour(&self) -> &[u8] {
        self.bytes().split_at(3 * self.pixels).0
    }

    /// Distance along the camera's z axis, metres; 0 where nothing was hit.
    #[must_use]
    pub fn depth_m(&self) -> &[f32] {
        self.sample.payload().split_at(self.pixels).0
    }

    /// Instance id of what was hit; 0 is background.
    #[must_use]
    pub fn instance(&self) -> &[u8] {
        self.bytes().split_at(3 * self.pixels).1
    }

    fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(self.sample.payload().split_at(self.pixels).1)
    }

    /// The frame, borrowed: what a policy sees.
    #[must_use]
    pub fn as_frame(&self) -> FrameRef<'_> {
        let header = self.header();
        FrameRef {
            stamp: header.stamp,
            sequence: header.sequence,
            intrinsics: header.intrinsics,
            camera_in_scene: header.camera_in_scene(),
            colour: self.colour(),
            depth_m: self.depth_m(),
            instance: self.instance(),
        }
    }

    /// Copies the frame into `frame`, whose buffers are reused if they are large enough.
    pub fn to_frame(&self, frame: &mut CameraFrame) {
        let header = self.header();
        frame.stamp = header.stamp;
        frame.sequence = header.sequence;
        frame.intrinsics = header.intrinsics;
        frame.camera_in_scene = header.camera_in_scene();
        replace(&mut frame.colour, self.colour());
        replace(&mut frame.depth_m, self.depth_m());
        replace(&mut frame.instance, self.instance());
    }
}

impl fmt::Debug for FrameView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FrameView")
            .field("header", self.header())
            .finish_non_exhaustive()
    }
}

fn replace<T: Copy>(into: &mut Vec<T>, from: &[T]) {
    into.clear();
    into.extend_from_slice(from);
}
