//! The tests of the whole program and of the library as a user sees it, in one binary: it is linked
//! once.

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
mod object;
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
