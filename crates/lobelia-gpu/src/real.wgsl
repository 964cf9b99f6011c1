// Numbers with the operations of `lobelia_sg::real`.

const PI = 3.141592653589793;

// `x` if positive, else 0.
fn relu(x: f32) -> f32 {
    return max(x, 0.0);
}

// e^x for x ≤ 0, at least e^−50.
fn decay(x: f32) -> f32 {
    return exp(max(x, -50.0));
}

// e^x for x ≤ 0, at least e^−60.
fn fading_exp(x: f32) -> f32 {
    return exp(max(x, -60.0));
}

// The magnitude of `x` with the sign of `signed`.
fn copysign(x: f32, signed: f32) -> f32 {
    return select(abs(x), -abs(x), signed < 0.0);
}

// 1/√x with a relative error of 2e-3, for where nodes lie: the same numbers as on the CPU.
fn rough_rsqrt(x: f32) -> f32 {
    let y = bitcast<f32>(0x5f3759dfu - (bitcast<u32>(x) >> 1u));
    return y * fma(x * -0.5 * y, y, 1.5);
}
