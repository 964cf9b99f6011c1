//! Loops whose indices are constants.

/// `for index in 0..count` for counts up to 4, unrolled so that the constants of every node are known at compile time.
macro_rules! unroll {
    ($index:ident < $count:expr, $body:block) => {
        unroll!(@ $index, $count, $body, 0 1 2 3)
    };
    (@ $index:ident, $count:expr, $body:block, $($i:literal)*) => {
        $(if $i < $count {
            let $index: usize = $i;
            $body
        })*
    };
}

pub(super) use unroll;
