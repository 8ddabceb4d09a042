//! The soft flap as it is drawn: bent anew for every instant.

use hal::Mesh;
use nalgebra::Vector3;
use trocar_render::visual::{Visual, instance};
use trocar_world::tissue::{FlapSnapshot, Patch, Surface};

use crate::task::TaskScene;

/// The drawn flap with its mark.
pub(super) struct DrawnFlap {
    surface: Surface,
    mark: Patch,
    /// Which visuals they are.
    surface_index: usize,
    mark_index: usize,
    nodes: Vec<Vector3<f64>>,
    /// What was drawn last.
    shown: Option<FlapSnapshot>,
}

impl DrawnFlap {
    /// The flap of `scene`, if it has one and `visuals` show it.
    pub(super) fn new(scene: &dyn TaskScene, visuals: &[Visual]) -> Option<Self> {
        let (config, mark_radius_m) = scene.flap()?;
        let index = |id| visuals.iter().position(|visual| visual.instance == id);
        let surface = config.surface();
        Some(Self {
            mark: Patch::new(&surface, [0.0; 2], mark_radius_m),
            surface_index: index(instance::TISSUE)?,
            mark_index: index(instance::MARK)?,
            nodes: Vec::with_capacity(surface.node_count()),
            surface,
            shown: None,
        })
    }

    /// Takes the shape of `flap`; whether that is another than before.
    pub(super) fn bend(&mut self, flap: &FlapSnapshot) -> bool {
        if self.shown.as_ref() == Some(flap) {
            return false;
        }
        self.nodes.clear();
        self.nodes
            .extend(flap.nodes().take(self.surface.node_count()));
        self.surface.update(&self.nodes);
        self.mark.update(&self.surface, flap.mark_m());
        self.shown = Some(*flap);
        true
    }

    /// The visuals that they are, with their shapes.
    pub(super) fn meshes(&self) -> [(usize, &Mesh); 2] {
        [
            (self.surface_index, self.surface.mesh()),
            (self.mark_index, self.mark.mesh()),
        ]
    }
}
