//! Pixel samples: the entities that are traced, shaded and compared.
//!
//! | module | holds |
//! | --- | --- |
//! | [`pixel`] | which pixel a sample is of, its ray, what the photograph shows there; the [`Window`] a run works on |
//! | [`point`] | where its ray meets the surface; the [`Scenery`](point::Scenery) that rays are cast against |
//! | [`bundle`] | all columns of a sample, for rendering and for fitting |

pub mod bundle;
pub mod pixel;
pub mod point;

use crate::error::Result;
use crate::pipeline::pool::{Columns, Pool};
use bevy_ecs::prelude::Res;
use bevy_ecs::system::SystemParam;
use pixel::{SampleIndex, Window};

/// The samples of the present [`Window`], as a system sees them: columns `D`, one row a sample, in the order of [`SampleIndex`].
#[derive(SystemParam)]
pub struct Samples<'w, 's, D: Columns + 'static> {
    window: Res<'w, Window>,
    pool: Pool<'w, 's, SampleIndex, D>,
}

impl<'w, 's, D: Columns + 'static> Samples<'w, 's, D> {
    /// The window's columns. Writing does not mark them as changed: every run makes them anew.
    ///
    /// # Errors
    /// If the pool has not all of the window's samples.
    pub fn columns(self) -> Result<D::Slices<'w>> {
        self.pool.rows(self.window.0.clone())
    }
}
