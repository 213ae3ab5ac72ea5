// One real orthonormal spherical harmonic at a unit direction, by the normalised recurrence of
// prt_bench/spherical/harmonics.py: z is the polar axis, index k = l(l + 1) + m, no Condon–Shortley phase.
float harmonic(int k, vec3 d) {
    int l = int(sqrt(float(k) + 0.5));
    int m = abs(k - l * (l + 1));
    vec2 azimuth = vec2(1.0, 0.0);  // (cos, sin) of mφ times sinᵐθ
    float value = 0.28209479177387814;
    for (int i = 1; i <= m; ++i) {
        azimuth = vec2(d.x * azimuth.x - d.y * azimuth.y, d.x * azimuth.y + d.y * azimuth.x);
        value *= sqrt(float(2 * i + 1) / float(2 * i));
    }
    float before = 0.0;
    float mm = float(m * m);
    for (int n = m + 1; n <= l; ++n) {
        float nn = float(n * n), last = float((n - 1) * (n - 1));
        float next = sqrt((4.0 * nn - 1.0) / (nn - mm)) * (d.z * value - sqrt((last - mm) / (4.0 * last - 1.0)) * before);
        before = value;
        value = next;
    }
    if (m == 0) return value;
    return 1.4142135623730951 * value * (k < l * (l + 1) ? azimuth.y : azimuth.x);
}
