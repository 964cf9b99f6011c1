// The integral of a light lobe times the clamped cosine: `accurate::diffuse` in Lobelia's crate of kernels.

const float PI = 3.14159265358979;

// e^(x^2) erfc(x) for x >= 0.
float scaledErfc(float x) {
    float s = 1.0 / (1.0 + 0.36 * x);
    float z = 2.0 * s - 1.0;
    float p = 7.47882407367e-5;
    p = p * z + 0.000106820557434;
    p = p * z - 0.000670684595379;
    p = p * z - 0.00195151911803;
    p = p * z + 0.00238949866222;
    p = p * z + 0.0272801696181;
    p = p * z + 0.0898987791954;
    p = p * z + 0.192277455528;
    p = p * z + 0.306753512712;
    p = p * z + 0.383841213067;
    return p * s;
}

float fadingExp(float x) {
    return exp(max(x, -60.0));
}

// (1 - e^-z)/z for small z >= 0.
float meanExponential(float z) {
    float p = 1.0 / 5040.0;
    p = p * z - 1.0 / 720.0;
    p = p * z + 1.0 / 120.0;
    p = p * z - 1.0 / 24.0;
    p = p * z + 1.0 / 6.0;
    p = p * z - 0.5;
    return p * z + 1.0;
}

// `terms` and `tail` depend on the sharpness alone (`sharpnessTerms` in light.js); c is the cosine of axis and normal.
float cosineIntegral(vec4 terms, float tail, float c) {
    c = clamp(c, -1.0, 1.0);
    float t = terms.x;
    float tc = t * c;
    float edge = fadingExp(-tc * tc);
    float bell = edge * scaledErfc(abs(tc));
    float share = tc < 0.0 ? bell : 2.0 - bell;
    float sine2 = (1.0 - c) * (1.0 + c);
    float z = t * t * sine2;
    float mean = z < 0.5 ? edge * meanExponential(z) : (edge - terms.w) / max(z, 0.5);
    float difference = -mean * sine2 * (0.5 / sqrt(PI));
    float blend = clamp(0.5 * (c * share + tail) - difference * t, 0.0, 1.0);
    return 2.0 * PI * ((terms.y - terms.z) * blend + terms.z);
}
