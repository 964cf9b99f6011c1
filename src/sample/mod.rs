//! Pixel samples: the entities that are traced, shaded and compared.
//!
//! | module | holds |
//! | --- | --- |
//! | [`pixel`] | the pixel of a sample, its ray, its radiance in the photograph; the [`Window`] of a run |
//! | [`observation`] | the pool of all pixels that a fit may visit |
//! | [`point`] | its surface point; the [`Scenery`](point::Scenery) that rays are cast against |
//! | [`turn`] | rotations of views for a light that does not stand still in the world |
//! | [`bundle`] | all columns of a sample, for rendering and for fitting |

pub mod bundle;
pub mod observation;
pub mod pixel;
pub mod point;
pub mod turn;

use crate::error::Result;
use crate::pipeline::pool::{Columns, Pool};
use bevy_ecs::prelude::Res;
use bevy_ecs::system::SystemParam;
use pixel::{SampleIndex, Window};

/// The samples of the current [`Window`], as a system parameter: columns `D`, one row per sample, in the order of [`SampleIndex`].
#[derive(SystemParam)]
pub struct Samples<'w, 's, D: Columns + 'static> {
    window: Res<'w, Window>,
    pool: Pool<'w, 's, SampleIndex, D>,
}

impl<'w, 's, D: Columns + 'static> Samples<'w, 's, D> {
    /// The window's columns. Writing does not mark them as changed, because every run recomputes them.
    ///
    /// # Errors
    /// If the pool does not have all samples of the window.
    pub fn columns(self) -> Result<D::Slices<'w>> {
        self.pool.rows(self.window.0.clone())
    }
}
