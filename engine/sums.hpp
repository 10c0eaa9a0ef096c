// Sums of products of whitened rows over poses: the normal equations, lower triangle, in blocks that
// stay in registers. Each sum runs in SUMS lanes over the poses in order, whatever the width. Rows of
// zeros, which a parameter of one coordinate has in the loops of the others, are left out: they add nothing.

// Rows in a block, as the registers of a width allow.
constexpr int BLOCK = LANES == 8 ? 4 : LANES == 4 ? 2 : 1;

INLINE int padded(int rows) { return (rows + 3) / 4 * 4; }

// The bit of a loop in a set of loops; the last one stands for all further loops together.
INLINE uint64_t bit(int loop) { return (uint64_t)1 << (loop < 63 ? loop : 63); }

// Whether a row has more than zeros; what is no number is no zero.
static bool some(const double* row, int poses) {
    for (int p = 0; p < poses; p += SUMS) {
        double size = 0.0;
        for (int s = 0; s < SUMS; s++) size += fabs(row[p + s]);
        if (!(size == 0.0)) return true;
    }
    return false;
}

// loops: those in which neither block has zeros alone; first: into sums that hold nothing yet
static void add_block(const double* const* left, const double* const* right, uint64_t loops, int r, int poses,
                      bool first, double* const* sums) {
    vec total[BLOCK][BLOCK][SV];
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++)
            for (int s = 0; s < SV; s++) total[i][j][s] = first ? all(0.0) : load(sums[i] + j * SUMS + s * LANES);
    for (int loop = 0; loop < r; loop++) {
        if (!(loops & bit(loop))) continue;
        for (int p = loop * PIECE; p < loop * PIECE + poses; p += SUMS)
            for (int s = 0; s < SV; s++) {
                vec b[BLOCK];
                for (int j = 0; j < BLOCK; j++) b[j] = load(right[j] + p + s * LANES);
                for (int i = 0; i < BLOCK; i++) {
                    const vec a = load(left[i] + p + s * LANES);
                    for (int j = 0; j < BLOCK; j++) total[i][j][s] += a * b[j];
                }
            }
    }
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++)
            for (int s = 0; s < SV; s++) store(sums[i] + j * SUMS + s * LANES, total[i][j][s]);
}

// piece: (width, r, PIECE), of which the first `poses` count; loops: (padded), room for a set of each
// block; sums: (padded, padded, SUMS)
static void add_products(const double* piece, int width, int r, int poses, bool first, uint64_t* loops, double* sums) {
    const ptrdiff_t row = (ptrdiff_t)r * PIECE;
    memset(loops, 0, sizeof(uint64_t) * padded(width));
    for (int i = 0; i < width; i++)
        for (int loop = 0; loop < r; loop++)
            if (some(piece + i * row + (ptrdiff_t)loop * PIECE, poses)) loops[i / BLOCK] |= bit(loop);
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
            add_block(left, right, loops[i / BLOCK] & loops[j / BLOCK], r, poses, first, to);
        }
}

static void finish_sums(const double* sums, int width, double* total) {
    for (int i = 0; i < width; i++)
        for (int j = 0; j <= i; j++) {
            const double* s = sums + ((ptrdiff_t)i * padded(width) + j) * SUMS;
            total[i * width + j] = ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]));
        }
}
