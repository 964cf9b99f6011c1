//! The slice kernels of every closed form. Apart from the unit tests, so that the kernels are
//! compiled once.

use lobelia_sg::*;

mod cases;
mod properties;
mod published_pairs;
mod slices;
