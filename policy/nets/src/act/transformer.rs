//! The encoder and decoder layers of ACT, normalising after (as published) or before their work.
//!
//! DETR's layers (Carion et al. 2020): positions are added to queries and keys in every layer,
//! never to values, and the decoder's queries are learned.

use tch::{TchError, Tensor};

use super::config::ActConfig;
use crate::layers::{Attention, FeedForward, LayerNorm, drop};
use crate::parameters::{ParameterError, ParameterSource};

/// A stack of encoder layers; with pre-normalisation a last normalisation follows.
#[derive(Debug)]
pub(super) struct Encoder {
    pub(super) layers: Vec<EncoderLayer>,
    /// None with normalisation after each layer's work, which leaves nothing to normalise.
    pub(super) norm: Option<LayerNorm>,
}

impl Encoder {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        layers: i64,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let layers = (0..layers)
            .map(|index| EncoderLayer::new(source, &format!("{key}.layers.{index}"), config))
            .collect::<Result<_, _>>()?;
        let norm = if config.pre_norm {
            Some(LayerNorm::new(
                source,
                &format!("{key}.norm"),
                config.dim_model,
            )?)
        } else {
            None
        };
        Ok(Self { layers, norm })
    }

    /// `(batch, tokens, width)`; `position` is added to queries and keys of every layer. `allowed`
    /// masks keys, as [`Attention::forward`] has it.
    pub(super) fn forward(
        &self,
        tokens: &Tensor,
        position: &Tensor,
        allowed: Option<&Tensor>,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let mut x = tokens.shallow_clone();
        for layer in &self.layers {
            x = layer.forward(&x, position, allowed, dropout)?;
        }
        match &self.norm {
            Some(norm) => norm.forward(&x),
            None => Ok(x),
        }
    }
}

/// Self-attention, then a feed-forward layer.
#[derive(Debug)]
pub(super) struct EncoderLayer {
    pub(super) attention: Attention,
    pub(super) feed_forward: FeedForward,
    pub(super) norms: [LayerNorm; 2],
    pub(super) pre_norm: bool,
}

impl EncoderLayer {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let width = config.dim_model;
        Ok(Self {
            attention: Attention::new(source, &format!("{key}.self_attn"), width, config.n_heads)?,
            feed_forward: FeedForward::new(source, key, width, config.dim_feedforward)?,
            norms: [
                LayerNorm::new(source, &format!("{key}.norm1"), width)?,
                LayerNorm::new(source, &format!("{key}.norm2"), width)?,
            ],
            pre_norm: config.pre_norm,
        })
    }

    fn forward(
        &self,
        x: &Tensor,
        position: &Tensor,
        allowed: Option<&Tensor>,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let x = residual(x, &self.norms[0], self.pre_norm, dropout, |x| {
            let located = x.f_add(position)?;
            self.attention
                .forward(&located, &located, x, allowed, dropout)
        })?;
        residual(&x, &self.norms[1], self.pre_norm, dropout, |x| {
            self.feed_forward.forward(x, dropout)
        })
    }
}

/// A stack of decoder layers, followed by a normalisation.
#[derive(Debug)]
pub(super) struct Decoder {
    pub(super) layers: Vec<DecoderLayer>,
    pub(super) norm: LayerNorm,
}

/// What the decoder looks at: the encoder's tokens and where they are.
pub(super) struct Memory<'a> {
    /// `(batch, tokens, width)`.
    pub(super) tokens: &'a Tensor,
    /// `(batch or 1, tokens, width)`.
    pub(super) position: &'a Tensor,
}

impl Decoder {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let layers = (0..config.built_decoder_layers())
            .map(|index| DecoderLayer::new(source, &format!("{key}.layers.{index}"), config))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            layers,
            norm: LayerNorm::new(source, &format!("{key}.norm"), config.dim_model)?,
        })
    }

    /// Starts from zeros; `queries` `(1, steps, width)` tells the steps apart.
    pub(super) fn forward(
        &self,
        queries: &Tensor,
        memory: &Memory<'_>,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let batch = memory.tokens.size()[0];
        let mut x = queries.f_zeros_like()?.f_expand([batch, -1, -1], false)?;
        for layer in &self.layers {
            x = layer.forward(&x, queries, memory, dropout)?;
        }
        self.norm.forward(&x)
    }
}

/// Self-attention of the steps, cross-attention to the encoder's tokens, then a feed-forward layer.
#[derive(Debug)]
pub(super) struct DecoderLayer {
    pub(super) self_attention: Attention,
    pub(super) cross_attention: Attention,
    pub(super) feed_forward: FeedForward,
    pub(super) norms: [LayerNorm; 3],
    pub(super) pre_norm: bool,
}

impl DecoderLayer {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let (width, heads) = (config.dim_model, config.n_heads);
        let place = |name: &str| format!("{key}.{name}");
        Ok(Self {
            self_attention: Attention::new(source, &place("self_attn"), width, heads)?,
            cross_attention: Attention::new(source, &place("multihead_attn"), width, heads)?,
            feed_forward: FeedForward::new(source, key, width, config.dim_feedforward)?,
            norms: [
                LayerNorm::new(source, &format!("{key}.norm1"), width)?,
                LayerNorm::new(source, &format!("{key}.norm2"), width)?,
                LayerNorm::new(source, &format!("{key}.norm3"), width)?,
            ],
            pre_norm: config.pre_norm,
        })
    }

    fn forward(
        &self,
        x: &Tensor,
        queries: &Tensor,
        memory: &Memory<'_>,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let x = self.look_at_each_other(x, queries, dropout)?;
        let x = residual(&x, &self.norms[1], self.pre_norm, dropout, |x| {
            let keys = memory.tokens.f_add(memory.position)?;
            self.cross_attention
                .forward(&x.f_add(queries)?, &keys, memory.tokens, None, dropout)
        })?;
        residual(&x, &self.norms[2], self.pre_norm, dropout, |x| {
            self.feed_forward.forward(x, dropout)
        })
    }

    /// The steps' attention to each other, the first part of the layer.
    pub(super) fn look_at_each_other(
        &self,
        x: &Tensor,
        queries: &Tensor,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        residual(x, &self.norms[0], self.pre_norm, dropout, |x| {
            let located = x.f_add(queries)?;
            self.self_attention
                .forward(&located, &located, x, None, dropout)
        })
    }
}

/// `x` plus what `work` makes of it, normalised before the work or after the sum. Pre-norm:
/// `x + drop(work(norm(x)))`; post-norm: `norm(x + drop(work(x)))`.
pub(super) fn residual(
    x: &Tensor,
    norm: &LayerNorm,
    pre_norm: bool,
    dropout: f64,
    work: impl FnOnce(&Tensor) -> Result<Tensor, TchError>,
) -> Result<Tensor, TchError> {
    if pre_norm {
        x.f_add(&drop(work(&norm.forward(x)?)?, dropout)?)
    } else {
        norm.forward(&x.f_add(&drop(work(x)?, dropout)?)?)
    }
}
