// Sums of products of whitened rows over poses: the normal equations, lower triangle, in blocks that
// stay in registers. Each sum runs in SUMS lanes over the poses in order, whatever the width.

// Rows in a block, as the registers of a width allow.
constexpr int BLOCK = LANES == 8 ? 4 : LANES == 4 ? 2 : 1;

INLINE int padded(int rows) { return (rows + 3) / 4 * 4; }

// first: into sums that hold nothing yet
static void add_block(const double* const* left, const double* const* right, int r, int poses, bool first,
                      double* const* sums) {
    vec total[BLOCK][BLOCK][SV];
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++)
            for (int s = 0; s < SV; s++) total[i][j][s] = first ? all(0.0) : load(sums[i] + j * SUMS + s * LANES);
    for (int loop = 0; loop < r; loop++)
        for (int p = loop * PIECE; p < loop * PIECE + poses; p += SUMS)
            for (int s = 0; s < SV; s++) {
                vec b[BLOCK];
                for (int j = 0; j < BLOCK; j++) b[j] = load(right[j] + p + s * LANES);
                for (int i = 0; i < BLOCK; i++) {
                    const vec a = load(left[i] + p + s * LANES);
                    for (int j = 0; j < BLOCK; j++) total[i][j][s] += a * b[j];
                }
            }
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++)
            for (int s = 0; s < SV; s++) store(sums[i] + j * SUMS + s * LANES, total[i][j][s]);
}

// piece: (width, r, PIECE), of which the first `poses` count; sums: (padded, padded, SUMS)
static void add_products(const double* piece, int width, int r, int poses, bool first, double* sums) {
    const ptrdiff_t row = (ptrdiff_t)r * PIECE;
    for (int i = 0; i < width; i += BLOCK)
        for (int j = 0; j <= i; j += BLOCK) {
            const double *left[BLOCK], *right[BLOCK];
            double* to[BLOCK];
            // rows beyond the last repeat it; what they add is never read
            for (int a = 0; a < BLOCK; a++) {
                left[a] = piece + (i + a < width ? i + a : width - 1) * row;
                to[a] = sums + ((ptrdiff_t)(i + a) * padded(width) + j) * SUMS;
            }
            for (int b = 0; b < BLOCK; b++) right[b] = piece + (j + b < width ? j + b : width - 1) * row;
            add_block(left, right, r, poses, first, to);
        }
}

static void finish_sums(const double* sums, int width, double* total) {
    for (int i = 0; i < width; i++)
        for (int j = 0; j <= i; j++) {
            const double* s = sums + ((ptrdiff_t)i * padded(width) + j) * SUMS;
            total[i * width + j] = ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]));
        }
}
