// The curve of gamma space and its inverse: a root for large values, a straight line for small ones. GAMMA, TOE.

const float CURVED_TOE = pow(TOE, 1.0 / GAMMA);

vec3 curve(vec3 v) { return 2.0 * CURVED_TOE * sinh(asinh(v / (2.0 * TOE)) / GAMMA); }

vec3 uncurve(vec3 w) { return 2.0 * TOE * sinh(asinh(w / (2.0 * CURVED_TOE)) * GAMMA); }
