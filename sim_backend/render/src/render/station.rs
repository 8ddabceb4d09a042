//! Where images are taken: targets and records for each camera whose image is under way, kept from
//! frame to frame.

use super::lens::{LensPass, Window};
use super::records::Records;
use super::targets::Targets;
use super::{Camera, RenderError, Shading};

/// What one camera's image needs while it is under way.
pub(super) struct Station {
    pub(super) targets: Targets,
    pub(super) records: Records,
}

/// Stations of several sizes.
#[derive(Default)]
pub(super) struct Stations {
    stations: Vec<Station>,
}

/// Most stations that are kept for later.
const KEPT: usize = 8;

/// What stations are made with.
pub(super) struct Plot<'a> {
    pub(super) device: &'a wgpu::Device,
    pub(super) records: &'a wgpu::BindGroupLayout,
    pub(super) parts: usize,
    pub(super) shading: Shading,
    /// Largest side of an image, pixels.
    pub(super) size_px_max: u32,
}

impl Plot<'_> {
    /// Whether the picture of `camera` takes more than a pinhole.
    fn has_lens(&self, camera: &Camera) -> bool {
        !camera.intrinsics.distortion.is_none()
            || (self.shading.shows_optics() && camera.optics.takes_pass())
    }

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
            targets: Targets::new(self.device, &camera.intrinsics, self.shading, lens),
            records: Records::new(self.device, self.records, self.parts),
        })
    }
}

impl Stations {
    /// Makes the first stations fit `cameras`, in order. A caller who takes images of the same
    /// sizes again and again finds them all there. `pass` is made when the first lens comes.
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

    pub(super) fn get(&self, index: usize) -> Option<&Station> {
        self.stations.get(index)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Station> {
        self.stations.iter()
    }
}
