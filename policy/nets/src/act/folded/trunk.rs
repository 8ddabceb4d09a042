//! Everything behind the tokens of what is seen.
//!
//! Tokens of all observations are rows of one matrix, `(batch * tokens, width)`, so that every
//! linear layer is one product; only attention looks at the batch. In the order latent, state, then
//! what is seen.

use tch::{Kind, TchError, Tensor};

use crate::act::transformer::{DecoderLayer, EncoderLayer, residual};
use crate::act::trunk::Trunk;
use crate::layers::affine::{Affine, Backend};
use crate::layers::folded::{CrossAttention, Rows, SelfAttention};
use crate::layers::{FeedForward, LayerNorm};

/// A transformer with latent zero.
#[derive(Debug)]
pub(crate) struct FoldedTrunk {
    encoder: Vec<FoldedEncoderLayer>,
    encoder_norm: Option<LayerNorm>,
    decoder: Vec<FoldedDecoderLayer>,
    decoder_norm: LayerNorm,
    /// The latent's token, `(1, 1, width)`.
    latent: Tensor,
    state_input: Affine,
    /// Where the latent and the state are, `(2, width)`.
    leading_position: Tensor,
    action_head: Affine,
}

/// The encoder's input tokens.
#[derive(Clone, Copy)]
pub(crate) struct FoldedEncoderInput<'a> {
    /// `(batch, tokens, width)`.
    pub(crate) tokens: &'a Tensor,
    /// Where they are, if building did not know it: `(batch, tokens, width)`.
    pub(crate) position: Option<&'a Tensor>,
}

/// Self-attention and feed-forward layer, each in a residual connection.
#[derive(Debug)]
struct FoldedEncoderLayer {
    attention: SelfAttention,
    feed_forward: FoldedFeedForward,
    norms: [LayerNorm; 2],
    /// Whether a normalisation comes before the work, as in [`residual`].
    pre_norm: bool,
}

/// Self-attention of the steps (or what it always gives), cross-attention, feed-forward layer.
#[derive(Debug)]
struct FoldedDecoderLayer {
    start: Start,
    cross_attention: CrossAttention,
    feed_forward: FoldedFeedForward,
    /// Of the cross-attention and of the feed-forward layer; that of the self-attention is in
    /// `start`.
    norms: [LayerNorm; 2],
    pre_norm: bool,
}

/// What comes before the attention to the encoder's tokens.
#[derive(Debug)]
enum Start {
    /// In the first layer: always the same.
    Known {
        /// `(steps, width)`.
        x: Tensor,
        /// Its queries, `(1, heads, steps, width of a head)`.
        queries: Tensor,
    },
    /// The steps look at each other.
    Computed {
        attention: Box<SelfAttention>,
        norm: LayerNorm,
    },
}

/// `narrow(relu(widen(x)))`; dropout is a matter of training.
#[derive(Debug)]
struct FoldedFeedForward {
    widen: Affine,
    narrow: Affine,
}

impl FoldedTrunk {
    /// `position` `(tokens, width)` of what is seen, if it is always the same.
    ///
    /// No gradient passes through its tensors; some share their memory with the trained ones, which
    /// must not change while it lives.
    pub(crate) fn new(
        trunk: &Trunk,
        position: Option<&Tensor>,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let kind = backend.kind();
        let leading = trunk.token_position.f_detach()?;
        let position = match position {
            Some(seen) => Some(Tensor::f_cat(&[&leading, seen], 0)?),
            None => None,
        };
        let layers = trunk.encoder.layers.iter();
        let encoder =
            layers.map(|layer| FoldedEncoderLayer::new(layer, position.as_ref(), backend));
        let queries = trunk.step_queries.f_detach()?;
        let zeros = queries.f_zeros_like()?;
        let mut decoder = Vec::new();
        for layer in &trunk.decoder.layers {
            let start = decoder.is_empty().then_some(&zeros);
            let folded =
                FoldedDecoderLayer::new(layer, &queries, start, position.as_ref(), backend)?;
            decoder.push(folded);
        }
        let norm = trunk.encoder.norm.as_ref();
        Ok(Self {
            encoder: encoder.collect::<Result<_, _>>()?,
            encoder_norm: norm.map(|norm| norm.of_kind(kind)).transpose()?,
            decoder,
            decoder_norm: trunk.decoder.norm.of_kind(kind)?,
            // Of a latent of zeros, only the bias is left.
            latent: trunk
                .latent_input
                .bias
                .f_detach()?
                .f_to_kind(kind)?
                .f_view([1, 1, -1])?,
            state_input: Affine::of(&trunk.state_input, backend)?,
            leading_position: leading.f_to_kind(kind)?,
            action_head: Affine::of(&trunk.action_head, backend)?,
        })
    }

    /// The chunk `(batch, steps, action)` in single precision.
    pub(crate) fn infer(
        &self,
        seen: &FoldedEncoderInput<'_>,
        state: &Tensor,
    ) -> Result<Tensor, TchError> {
        let (kind, batch) = (self.latent.kind(), seen.tokens.size()[0]);
        let state = self.state_input.forward(&state.f_to_kind(kind)?)?;
        let latent = self.latent.f_expand([batch, -1, -1], false)?;
        let state = state.f_unsqueeze(1)?;
        let mut x = Tensor::f_cat(&[&latent, &state, seen.tokens], 1)?.f_flatten(0, 1)?;
        let position = match seen.position {
            Some(position) => {
                let leading = self.leading_position.f_expand([batch, -1, -1], false)?;
                let position = position.f_to_kind(kind)?;
                Some(Tensor::f_cat(&[leading, position], 1)?.f_flatten(0, 1)?)
            }
            None => None,
        };
        let rows = Rows {
            batch,
            position: position.as_ref(),
        };
        for layer in &self.encoder {
            x = layer.forward(&x, rows)?;
        }
        if let Some(norm) = &self.encoder_norm {
            x = norm.forward(&x)?;
        }
        let mut steps = None;
        for layer in &self.decoder {
            steps = Some(layer.forward(steps, &x, rows)?);
        }
        let Some(steps) = steps else {
            return Err(TchError::Shape("no decoder layer".to_owned()));
        };
        let chunk = self
            .action_head
            .forward(&self.decoder_norm.forward(&steps)?)?;
        chunk.f_unflatten(0, [batch, -1])?.f_to_kind(Kind::Float)
    }
}

impl FoldedEncoderLayer {
    fn new(
        layer: &EncoderLayer,
        position: Option<&Tensor>,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let [first, second] = &layer.norms;
        let kind = backend.kind();
        Ok(Self {
            attention: SelfAttention::new(&layer.attention, position, backend)?,
            feed_forward: FoldedFeedForward::new(&layer.feed_forward, backend)?,
            norms: [first.of_kind(kind)?, second.of_kind(kind)?],
            pre_norm: layer.pre_norm,
        })
    }

    fn forward(&self, x: &Tensor, rows: Rows<'_>) -> Result<Tensor, TchError> {
        let x = residual(x, &self.norms[0], self.pre_norm, 0.0, |x| {
            self.attention.forward(x, rows)
        })?;
        residual(&x, &self.norms[1], self.pre_norm, 0.0, |x| {
            self.feed_forward.forward(x)
        })
    }
}

impl FoldedDecoderLayer {
    /// `queries` and `zeros` are `(steps, width)`; the latter is there if the layer is the first.
    fn new(
        layer: &DecoderLayer,
        queries: &Tensor,
        zeros: Option<&Tensor>,
        position: Option<&Tensor>,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let cross = &layer.cross_attention;
        let [first, second, third] = &layer.norms;
        let kind = backend.kind();
        let start = match zeros {
            Some(zeros) => {
                let batched = |x: &Tensor| x.f_unsqueeze(0);
                let x = layer
                    .look_at_each_other(&batched(zeros)?, &batched(queries)?, 0.0)?
                    .f_squeeze_dim(0)?;
                let asking = if layer.pre_norm {
                    second.forward(&x)?
                } else {
                    x.shallow_clone()
                };
                // In the precision of training, whatever `kind` is.
                let exact = CrossAttention::new(cross, queries, None, Backend::Torch(x.kind()))?;
                Start::Known {
                    queries: exact.queries(&asking, 1)?.f_detach()?.f_to_kind(kind)?,
                    x: x.f_detach()?.f_to_kind(kind)?,
                }
            }
            None => Start::Computed {
                attention: Box::new(SelfAttention::new(
                    &layer.self_attention,
                    Some(queries),
                    backend,
                )?),
                norm: first.of_kind(kind)?,
            },
        };
        Ok(Self {
            start,
            cross_attention: CrossAttention::new(cross, queries, position, backend)?,
            feed_forward: FoldedFeedForward::new(&layer.feed_forward, backend)?,
            norms: [second.of_kind(kind)?, third.of_kind(kind)?],
            pre_norm: layer.pre_norm,
        })
    }

    /// `steps` is what the layer before made, of the first layer nothing.
    fn forward(
        &self,
        steps: Option<Tensor>,
        memory: &Tensor,
        rows: Rows<'_>,
    ) -> Result<Tensor, TchError> {
        let batch = rows.batch;
        let look = |queries: &Tensor| self.cross_attention.forward(queries, memory, rows);
        let [second, third] = &self.norms;
        let x = match (&self.start, steps) {
            (Start::Known { x, queries }, _) => {
                let x = x.f_repeat([batch, 1])?;
                let queries = queries.f_expand([batch, -1, -1, -1], false)?;
                let sum = x.f_add(&look(&queries)?)?;
                if self.pre_norm {
                    sum
                } else {
                    second.forward(&sum)?
                }
            }
            (Start::Computed { attention, norm }, Some(x)) => {
                let among = Rows {
                    batch,
                    position: None,
                };
                let x = residual(&x, norm, self.pre_norm, 0.0, |x| {
                    attention.forward(x, among)
                })?;
                residual(&x, second, self.pre_norm, 0.0, |x| {
                    look(&self.cross_attention.queries(x, batch)?)
                })?
            }
            (Start::Computed { .. }, None) => {
                return Err(TchError::Shape("no step to start from".to_owned()));
            }
        };
        residual(&x, third, self.pre_norm, 0.0, |x| {
            self.feed_forward.forward(x)
        })
    }
}

impl FoldedFeedForward {
    fn new(layer: &FeedForward, backend: Backend) -> Result<Self, TchError> {
        Ok(Self {
            widen: Affine::of(&layer.widen, backend)?,
            narrow: Affine::of(&layer.narrow, backend)?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.narrow.forward(&self.widen.rectified(x)?)
    }
}
