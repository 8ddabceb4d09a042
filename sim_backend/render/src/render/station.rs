//! Where images are taken: targets and records for each camera whose image is under way, kept from
//! frame to frame.
//!
//! Making targets allocates on the device, and callers take images of the same sizes again and
//! again. From `KEPT` stations on, those that the present call does not use are dropped before
//! another one is made; a call with more cameras still gets one for each.

use super::deferred::Deferred;
use super::lens::{LensPass, Window};
use super::records::Records;
use super::targets::Targets;
use super::{Camera, RenderError, Shading};

/// What one camera's image needs while it is under way.
pub(super) struct Station {
    /// Images and staging buffer of its size.
    pub(super) targets: Targets,
    /// Written for each image; no two images under way share them.
    pub(super) records: Records,
}

/// Stations of several sizes.
#[derive(Default)]
pub(super) struct Stations {
    /// The first ones are those of the cameras of the last call, in their order.
    stations: Vec<Station>,
}

/// From how many stations on those that no camera of the call has taken yet are dropped when
/// another one has to be made.
const KEPT: usize = 8;

/// What stations are made with.
pub(super) struct Plot<'a> {
    /// Makes textures and buffers.
    pub(super) device: &'a wgpu::Device,
    /// Layout of the records' group.
    pub(super) records: &'a wgpu::BindGroupLayout,
    /// Objects of the scene.
    pub(super) parts: usize,
    /// It decides which targets fit, and whether optics are shown.
    pub(super) shading: Shading,
    /// What shades fine pictures.
    pub(super) deferred: Option<&'a Deferred>,
    /// Largest side of an image, pixels.
    pub(super) size_px_max: u32,
}

impl Plot<'_> {
    /// Whether the picture of `camera` takes more than a pinhole.
    fn has_lens(&self, camera: &Camera) -> bool {
        !camera.intrinsics.distortion.is_none()
            || (self.shading.shows_optics() && camera.optics.takes_pass())
    }

    /// A new one for `camera`.
    fn station(
        &self,
        camera: &Camera,
        pass: &mut Option<LensPass>,
    ) -> Result<Station, RenderError> {
        let lens = if self.has_lens(camera) {
            let window = Window::of(&camera.intrinsics, self.size_px_max)?;
            let pass = pass.get_or_insert_with(|| LensPass::new(self.device));
            Some((&*pass, window))
        } else {
            None
        };
        Ok(Station {
            targets: Targets::new(
                self.device,
                &camera.intrinsics,
                self.shading,
                lens,
                self.deferred,
            ),
            records: Records::new(self.device, self.records, self.parts),
        })
    }
}

impl Stations {
    /// Makes the first stations fit `cameras`, in order. A caller who takes images of the same
    /// sizes again and again finds them all there. `pass` is made when the first lens comes.
    ///
    /// Searches among the stations that no camera before has taken, and swaps the one found to its
    /// place.
    pub(super) fn fit<'a>(
        &mut self,
        plot: &Plot<'_>,
        cameras: impl Iterator<Item = &'a Camera>,
        pass: &mut Option<LensPass>,
    ) -> Result<(), RenderError> {
        for (index, camera) in cameras.enumerate() {
            let (lens, has_lens) = (&camera.intrinsics, plot.has_lens(camera));
            let free = self.stations.iter().skip(index);
            let fitting = free
                .zip(index..)
                .find(|(station, _)| station.targets.fits(lens, plot.shading, has_lens));
            let found = if let Some((_, found)) = fitting {
                found
            } else {
                if self.stations.len() >= KEPT {
                    self.stations.truncate(index);
                }
                self.stations.push(plot.station(camera, pass)?);
                self.stations.len() - 1
            };
            self.stations.swap(index, found);
        }
        Ok(())
    }

    /// That of the camera `index` of the last [`Self::fit`].
    pub(super) fn get(&self, index: usize) -> Option<&Station> {
        self.stations.get(index)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Station> {
        self.stations.iter()
    }
}
