//! Where images are taken: targets and records for each camera whose image is under way, kept from frame to frame.

use hal::Intrinsics;

use super::Shading;
use super::records::Records;
use super::targets::Targets;

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

impl Stations {
    /// Makes the first stations fit `lenses`, in order. A caller who takes images of the same sizes again and again finds
    /// them all there.
    pub(super) fn fit<'a>(
        &mut self,
        device: &wgpu::Device,
        (layout, parts, shading): (&wgpu::BindGroupLayout, usize, Shading),
        lenses: impl Iterator<Item = &'a Intrinsics>,
    ) {
        for (index, lens) in lenses.enumerate() {
            let free = self.stations.iter().skip(index);
            let fitting = free
                .zip(index..)
                .find(|(station, _)| station.targets.fits(lens, shading));
            let found = if let Some((_, found)) = fitting {
                found
            } else {
                if self.stations.len() >= KEPT {
                    self.stations.truncate(index);
                }
                self.stations.push(Station {
                    targets: Targets::new(device, lens, shading),
                    records: Records::new(device, layout, parts),
                });
                self.stations.len() - 1
            };
            self.stations.swap(index, found);
        }
    }

    pub(super) fn get(&self, index: usize) -> Option<&Station> {
        self.stations.get(index)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Station> {
        self.stations.iter()
    }
}
