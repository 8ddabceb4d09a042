//! Facts about the retraction's scene.

use super::*;
