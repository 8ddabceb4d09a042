//! The backbone with its fixed normalisations inside the convolutions, channels last in memory.
//!
//! On the CPU with one thread most convolutions are ours, with fewer multiplications than the library's.

use tch::{Device, Kind, TchError, Tensor};

use crate::act::resnet::{Block, Conv, NORM_EPS, Norm, ResNet18};
use crate::layers::winograd::{Plane, Winograd, Workspace};

#[derive(Debug)]
pub(super) struct FoldedBackbone {
    stem: FoldedConv,
    blocks: Vec<FoldedBlock>,
    workspace: Workspace,
}

#[derive(Debug)]
struct FoldedBlock {
    first: FoldedConv,
    second: FoldedConv,
    downsample: Option<FoldedConv>,
}

/// What goes from layer to layer: of the library, ours, or both.
#[derive(Default)]
struct Map {
    tensor: Option<Tensor>,
    plane: Option<Plane>,
}

/// A convolution and what is left of its normalisation.
#[derive(Debug)]
struct FoldedConv {
    weight: Tensor,
    bias: Option<Tensor>,
    stride: i64,
    padding: i64,
    group_norm: Option<GroupNorm>,
    /// The same, followed by a rectifier, for pictures of which it pays.
    winograd: Option<Winograd>,
}

#[derive(Debug)]
struct GroupNorm {
    groups: i64,
    weight: Tensor,
    bias: Tensor,
}

impl FoldedBackbone {
    pub(super) fn new(backbone: &ResNet18, kind: Kind) -> Result<Self, TchError> {
        let block = |block: &Block| {
            let downsample = block.downsample.as_ref();
            Ok(FoldedBlock {
                first: FoldedConv::new(&block.first, kind)?,
                second: FoldedConv::new(&block.second, kind)?,
                downsample: downsample
                    .map(|conv| FoldedConv::new(conv, kind))
                    .transpose()?,
            })
        };
        Ok(Self {
            stem: FoldedConv::new(&backbone.stem, kind)?,
            blocks: backbone
                .blocks
                .iter()
                .map(block)
                .collect::<Result<_, TchError>>()?,
            workspace: Workspace::default(),
        })
    }

    /// `(n, 3, h, w)` to `(n * h / 32 * w / 32, 512)`, row by row, sizes rounded up.
    pub(super) fn forward(&mut self, images: &Tensor) -> Result<Tensor, TchError> {
        let x = self.stem.forward(images)?;
        // The greatest of the rectified is the rectified greatest, of which there are fewer.
        let mut x = x.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        let mut x = Map::from(x.f_relu_()?);
        for block in &self.blocks {
            x = block.forward(x, &mut self.workspace)?;
        }
        let rows = x.tensor()?.f_permute([0, 2, 3, 1])?.f_flatten(0, 2);
        x.give_back(&mut self.workspace);
        rows
    }
}

impl From<Tensor> for Map {
    fn from(tensor: Tensor) -> Self {
        Self {
            tensor: Some(tensor),
            plane: None,
        }
    }
}

impl From<Plane> for Map {
    fn from(plane: Plane) -> Self {
        Self {
            tensor: None,
            plane: Some(plane),
        }
    }
}

impl Map {
    fn tensor(&mut self) -> Result<&Tensor, TchError> {
        let tensor = match (self.tensor.take(), &self.plane) {
            (Some(tensor), _) => tensor,
            (None, Some(plane)) => plane.tensor()?,
            (None, None) => return Err(TchError::Shape("no map".to_owned())),
        };
        Ok(self.tensor.insert(tensor))
    }

    fn plane(&mut self, workspace: &mut Workspace) -> Result<&Plane, TchError> {
        let plane = match self.plane.take() {
            Some(plane) => plane,
            None => workspace.plane_of(self.tensor()?)?,
        };
        Ok(self.plane.insert(plane))
    }

    /// Height and width.
    fn sides(&self) -> Result<[usize; 2], TchError> {
        match (&self.tensor, &self.plane) {
            (_, Some(plane)) => Ok(plane.sides()),
            (Some(tensor), None) => {
                let (_, _, height, width) = tensor.size4()?;
                Ok([height, width].map(|side| usize::try_from(side).unwrap_or(0)))
            }
            (None, None) => Ok([0; 2]),
        }
    }

    /// Its memory is for others.
    fn give_back(self, workspace: &mut Workspace) {
        if let Some(plane) = self.plane {
            workspace.give_back(plane);
        }
    }
}

impl FoldedBlock {
    fn forward(&self, mut x: Map, workspace: &mut Workspace) -> Result<Map, TchError> {
        let mut inner = self.first.rectified(&mut x, None, workspace)?;
        let mut identity = match &self.downsample {
            Some(downsample) => Map::from(downsample.forward(x.tensor()?)?),
            None => std::mem::take(&mut x),
        };
        let beside = Some(&mut identity);
        let out = self.second.rectified(&mut inner, beside, workspace)?;
        for map in [x, inner, identity] {
            map.give_back(workspace);
        }
        Ok(out)
    }
}

impl FoldedConv {
    fn new(conv: &Conv, kind: Kind) -> Result<Self, TchError> {
        let weight = conv.weight.f_detach()?;
        let (weight, bias, group_norm) = match &conv.norm {
            Norm::Frozen { scale, shift } => {
                let weight = weight.f_mul(&scale.f_view([-1, 1, 1, 1])?)?;
                (weight, Some(shift.f_view([-1])?.f_to_kind(kind)?), None)
            }
            Norm::Group {
                groups,
                weight: scale,
                bias,
            } => {
                let group_norm = GroupNorm {
                    groups: *groups,
                    weight: scale.f_detach()?.f_to_kind(kind)?,
                    bias: bias.f_detach()?.f_to_kind(kind)?,
                };
                (weight, None, Some(group_norm))
            }
        };
        let ours = kind == Kind::Float
            && weight.device() == Device::Cpu
            && tch::get_num_threads() == 1
            && weight.size().ends_with(&[3, 3])
            && conv.stride == 1;
        let winograd = match &bias {
            Some(bias) if ours => Some(Winograd::new(&weight, bias)?),
            _ => None,
        };
        let last = weight.f_to_kind(kind)?.f_permute([0, 2, 3, 1])?;
        Ok(Self {
            winograd,
            weight: last.f_contiguous()?.f_permute([0, 3, 1, 2])?,
            bias,
            stride: conv.stride,
            padding: conv.padding,
            group_norm,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        let bias = self.bias.as_ref();
        let x = x.f_conv2d(&self.weight, bias, stride, padding, [1, 1], 1)?;
        match &self.group_norm {
            Some(norm) => {
                let GroupNorm { weight, bias, .. } = norm;
                x.f_group_norm(norm.groups, Some(weight), Some(bias), NORM_EPS, true)
            }
            None => Ok(x),
        }
    }

    /// With a rectifier behind it, before which `beside` is added if there is something.
    fn rectified(
        &self,
        x: &mut Map,
        beside: Option<&mut Map>,
        workspace: &mut Workspace,
    ) -> Result<Map, TchError> {
        if let Some(winograd) = &self.winograd {
            let [height, width] = x.sides()?;
            if Winograd::pays(height, width) {
                let x = x.plane(workspace)?;
                let beside = beside.map(|beside| beside.plane(workspace)).transpose()?;
                return Ok(winograd.apply(x, beside, workspace)?.into());
            }
        }
        let mut y = self.forward(x.tensor()?)?;
        if let Some(beside) = beside {
            y = y.f_add_(beside.tensor()?)?;
        }
        Ok(y.f_relu_()?.into())
    }
}
