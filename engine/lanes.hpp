// Vectors of LANES doubles and the functions of a tape on them. Included once for each width, inside
// a namespace of its own. Nothing is contracted or reordered: every width gives the same bits.

typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ivec __attribute__((vector_size(8 * LANES)));

#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const double* at) { return *(const vec*)at; }
INLINE void store(double* at, vec value) { *(vec*)at = value; }
INLINE vec all(double value) { return value - (vec){}; }
INLINE ivec all_bits(int64_t value) { return value - (ivec){}; }
INLINE vec choose(ivec where, vec yes, vec no) { return (vec)((where & (ivec)yes) | (~where & (ivec)no)); }
INLINE vec magnitude(vec a) { return (vec)((ivec)a & all_bits(INT64_MAX)); }
INLINE vec with_sign_of(vec a, vec sign) {
    return (vec)(((ivec)a & all_bits(INT64_MAX)) | ((ivec)sign & all_bits(INT64_MIN)));
}
INLINE bool any(ivec where) {
    int64_t found = 0;
    for (int i = 0; i < LANES; i++) found |= where[i];
    return found != 0;
}
INLINE vec root(vec a) {
    vec out;
    for (int i = 0; i < LANES; i++) out[i] = sqrt(a[i]);  // becomes one instruction
    return out;
}

// sin and cos together. Cody and Waite's reduction by pi/2 in three parts, 33 + 33 + 53 bits, the
// rest of the subtraction kept; polynomials of fdlibm (Sun Microsystems 1993). Below 1 ulp. Where
// the argument is large, or so near a multiple of pi/2 that 119 bits are too few, libm answers.
static __attribute__((noinline)) void sincos_by_lane(const double* a, double* s, double* c) {
    for (int i = 0; i < LANES; i++) {
        s[i] = sin(a[i]);
        c[i] = cos(a[i]);
    }
}

INLINE void sincos_of(vec x, vec* sine, vec* cosine) {
    const vec magic = all(0x1.8p52), shifted = x * all(0x1.45f306dc9c883p-1) + magic;
    const vec n = shifted - magic;
    const ivec quadrant = (ivec)shifted;
    const vec d = x - n * all(0x1.921fb544p+0), t = n * all(0x1.0b4611a6p-34);
    const vec high = d - t;
    const vec low = n * all(0x1.3198a2e037073p-69) - ((d - high) - t);
    const vec r = high - low, tail = (high - r) - low;

    const vec z = r * r, w = z * z;
    const vec ps = all(8.33333333332248946124e-03) +
                   z * (all(-1.98412698298579493134e-04) + z * all(2.75573137070700676789e-06)) +
                   z * w * (all(-2.50507602534068634195e-08) + z * all(1.58969099521155010221e-10));
    const vec cube = z * r;
    const vec s = r - ((z * (all(0.5) * tail - cube * ps) - tail) + cube * all(1.66666666666666324348e-01));
    const vec pc = z * (all(4.16666666666666019037e-02) +
                        z * (all(-1.38888888888741095749e-03) + z * all(2.48015872894767294178e-05))) +
                   w * w * (all(-2.75573143513906633035e-07) +
                            z * (all(2.08757232129817482790e-09) + z * all(-1.13596475577881948265e-11)));
    const vec half = all(0.5) * z, one = all(1.0) - half;
    const vec c = one + (((all(1.0) - one) - half) + (z * pc - r * tail));

    const ivec odd = (quadrant & all_bits(1)) != 0;
    const ivec two = all_bits(2);
    const ivec sine_sign = (quadrant & two) << 62, cosine_sign = ((quadrant + all_bits(1)) & two) << 62;
    *sine = (vec)((ivec)choose(odd, c, s) ^ sine_sign);
    *cosine = (vec)((ivec)choose(odd, s, c) ^ cosine_sign);
    const ivec easy = (magnitude(x) < all(0x1p17)) & (magnitude(r) >= magnitude(n) * all(0x1p-60));
    if (__builtin_expect(any(~easy), 0)) {
        double a[LANES] __attribute__((aligned(64))), by_lane[2][LANES] __attribute__((aligned(64)));
        store(a, x);
        sincos_by_lane(a, by_lane[0], by_lane[1]);
        *sine = choose(easy, *sine, load(by_lane[0]));
        *cosine = choose(easy, *cosine, load(by_lane[1]));
    }
}
