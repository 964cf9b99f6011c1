//! The tests of the whole program and of the library as a user sees it, in one binary: it is linked once.
//!
//! | theme | files |
//! | --- | --- |
//! | runs of the command | [`run`], [`photos`], [`materials`], [`lights`], [`export`], [`pages`], [`env`], [`scores`], [`jobs`] |
//! | what is written where, and what never is; runs that are stopped, or looked at | [`outputs`], [`resume`], `stop` |
//! | late failures, nonsense, edges | [`trust`], [`guard`] |
//! | what is refused, and how | [`check`], [`hostile`], [`mutants`], [`scene_errors`] |
//! | systems in a world, pictures | [`ecs`], [`shading`], [`films`] |
//! | the documentation | [`docs`] |

mod common;

mod check;
mod docs;
mod ecs;
mod env;
mod export;
mod films;
mod guard;
mod hostile;
mod jobs;
mod lights;
mod materials;
mod mutants;
mod outputs;
mod pages;
mod photos;
mod resume;
mod run;
mod scene_errors;
mod scores;
mod shading;
#[cfg(unix)]
mod stop;
mod trust;
