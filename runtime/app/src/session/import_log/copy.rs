//! The images of an episode, decoded one at a time, into the dataset.

use std::collections::BTreeMap;
use std::path::Path;

use hal::TimeNs;
use image::imageops::{self, FilterType};
use trocar_data::dataset::{CameraSpec, DatasetWriter, FrameRecord};
use trocar_log::{LoggedItem, read_items};

use super::LogImportError;
use super::episode::LoggedEpisode;
use super::frames::{decoded, undecodable};
use crate::session::SessionError;

/// Adds all steps of `episode` to the one in progress, of `cameras`; images are brought to their
/// size if it is given as `size`.
///
/// # Errors
/// [`LogImportError::Image`]; what the log or the dataset says.
pub(super) fn copy(
    episode: &LoggedEpisode,
    cameras: &[CameraSpec],
    size: Option<(u32, u32)>,
    writer: &mut DatasetWriter,
) -> Result<(), SessionError> {
    let mut copying = Copying::new(episode, cameras, size);
    let mut copied = Ok(());
    read_items(&episode.log, |item| {
        if let LoggedItem::Image { camera, at, image } = item
            && copied.is_ok()
        {
            copied = copying.take(camera, at, image, writer);
        }
    })?;
    copied
}

/// An episode on its way.
struct Copying<'a> {
    episode: &'a LoggedEpisode,
    cameras: Vec<CopiedCamera<'a>>,
    size: Option<(u32, u32)>,
    /// Steps that are written.
    done: usize,
}

/// A camera on its way.
struct CopiedCamera<'a> {
    name: &'a str,
    /// Which frames are wanted, by their place in the file.
    wanted: Vec<bool>,
    /// How many have come.
    come: usize,
    /// Those that are wanted and wait for other cameras, as they are in the file.
    waiting: BTreeMap<usize, (TimeNs, Vec<u8>)>,
    /// The place of the frame that is decoded, and its RGB.
    shown: Option<(usize, Vec<u8>)>,
}

impl<'a> CopiedCamera<'a> {
    /// The camera `index` of `episode`.
    fn new(episode: &LoggedEpisode, index: usize, name: &'a str) -> Self {
        let mut wanted = Vec::new();
        for (step, _) in &episode.steps {
            let place = step.places[index];
            if wanted.len() <= place {
                wanted.resize(place + 1, false);
            }
            wanted[place] = true;
        }
        Self {
            name,
            wanted,
            come: 0,
            waiting: BTreeMap::new(),
            shown: None,
        }
    }

    /// Keeps the next frame of the file if it is wanted.
    fn take(&mut self, at: TimeNs, image: &[u8]) {
        let place = self.come;
        self.come += 1;
        if self.wanted.get(place) == Some(&true) {
            self.waiting.insert(place, (at, image.to_vec()));
        }
    }

    /// Whether the frame at `place` is there.
    fn has(&self, place: usize) -> bool {
        self.waiting.contains_key(&place) || self.shown.as_ref().is_some_and(|it| it.0 == place)
    }

    /// Decodes the frame at `place`, unless it is already. Frames are shown in the order of steps,
    /// so that each is decoded once.
    fn show(
        &mut self,
        log: &Path,
        place: usize,
        size: Option<(u32, u32)>,
    ) -> Result<(), LogImportError> {
        let Some((at, image)) = self.waiting.remove(&place) else {
            return Ok(());
        };
        let image = decoded(&image).map_err(|source| undecodable(log, self.name, at, source))?;
        let image = match size {
            Some((width, height)) if image.dimensions() != (width, height) => {
                imageops::resize(&image, width, height, FilterType::Triangle)
            }
            Some(_) | None => image,
        };
        self.shown = Some((place, image.into_raw()));
        Ok(())
    }

    fn rgb(&self) -> &[u8] {
        self.shown.as_ref().map_or(&[], |(_, rgb)| rgb)
    }
}

impl<'a> Copying<'a> {
    fn new(
        episode: &'a LoggedEpisode,
        cameras: &'a [CameraSpec],
        size: Option<(u32, u32)>,
    ) -> Self {
        let cameras = cameras.iter().enumerate();
        let cameras = cameras.map(|(index, it)| CopiedCamera::new(episode, index, &it.name));
        Self {
            episode,
            cameras: cameras.collect(),
            size,
            done: 0,
        }
    }

    /// Takes the next image of the file, and writes the steps that have all of theirs.
    fn take(
        &mut self,
        camera: &str,
        at: TimeNs,
        image: &[u8],
        writer: &mut DatasetWriter,
    ) -> Result<(), SessionError> {
        let Some(camera) = self.cameras.iter_mut().find(|it| it.name == camera) else {
            return Ok(());
        };
        camera.take(at, image);
        while let Some((seen, row)) = self.episode.steps.get(self.done) {
            let mut places = self.cameras.iter_mut().zip(&seen.places);
            if !places.by_ref().all(|(camera, &place)| camera.has(place)) {
                return Ok(());
            }
            for (camera, &place) in self.cameras.iter_mut().zip(&seen.places) {
                camera.show(&self.episode.log, place, self.size)?;
            }
            let images: Vec<&[u8]> = self.cameras.iter().map(CopiedCamera::rgb).collect();
            let frame = FrameRecord {
                arms: &row.arms,
                images: &images,
                depth: &[],
            };
            writer.push_frame_of(&frame, row.by_hand)?;
            self.done += 1;
        }
        Ok(())
    }
}
