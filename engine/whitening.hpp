// The block kernel for one tile of poses: what loopcal/estimation/kernel.py says, in its order.

constexpr double SINGULAR = 1e-13, REORTHOGONAL = 0.03, ROUNDED_AWAY = 1e-13, FLAT = 1e-12;
constexpr double UNMEASURED_SCALE = 1e-3, EPSILON = 0x1p-52;

// Rows of TILE poses, one after the other.
struct Room {
    double* next;
    double* rows(int count) {
        double* const begin = next;
        next += (ptrdiff_t)count * TILE;
        return begin;
    }
};

// One row of poses, or one number for all of them (step 0).
struct View {
    const double* at;
    ptrdiff_t step;
    vec operator[](int v) const { return load(at + v * step); }
};

INLINE View view(const double* row) { return {row, LANES}; }
INLINE View view(const double* workspace, Operand operand) {
    return {workspace + operand.at, operand.step * LANES};
}

struct Reflections {
    int u, m;
    double *vectors, *scales, *columns;  // (u, m), (u), (u, m): of it rows i <= j are the triangle

    const double* vector(int j, int i) const { return vectors + ((ptrdiff_t)j * m + i) * TILE; }
    double* column(int j, int i) const { return columns + ((ptrdiff_t)j * m + i) * TILE; }

    // what reflection j does to m rows
    void reflect(int j, double* part) const {
        vec weight[TV] = {};
        for (int i = j; i < m; i++)
            EACH weight[v] += load(vector(j, i) + v * LANES) * load(part + i * TILE + v * LANES);
        EACH weight[v] *= load(scales + j * TILE + v * LANES);
        for (int i = j; i < m; i++)
            EACH {
                double* const at = part + i * TILE + v * LANES;
                store(at, load(at) - load(vector(j, i) + v * LANES) * weight[v]);
            }
    }
    void apply(double* part) const {
        for (int j = 0; j < u; j++) reflect(j, part);
    }
    void triangularise() {
        for (int j = 0; j < u; j++) {
            vec square[TV] = {};
            for (int i = j; i < m; i++)
                EACH {
                    const vec a = load(column(j, i) + v * LANES);
                    store(vectors + ((ptrdiff_t)j * m + i) * TILE + v * LANES, a);
                    square[v] += a * a;
                }
            EACH {
                double* const head = vectors + ((ptrdiff_t)j * m + j) * TILE + v * LANES;
                const vec first = load(head), longer = first + with_sign_of(root(square[v]), first);
                store(head, longer);
                square[v] = longer * longer;
            }
            for (int i = j + 1; i < m; i++)
                EACH {
                    const vec a = load(vector(j, i) + v * LANES);
                    square[v] += a * a;
                }
            EACH {
                const ivec there = square[v] > all(0.0);
                const vec scale = all(2.0) / choose(there, square[v], all(1.0));
                store(scales + j * TILE + v * LANES, choose(there, scale, all(0.0)));
            }
            for (int c = j; c < u; c++) reflect(j, column(c, 0));
        }
    }
    // the steps of the unmeasured quantities from the first u rows, in their place
    void solve(double* right) const {
        for (int i = u - 1; i >= 0; i--)
            EACH {
                vec rest = load(right + i * TILE + v * LANES);
                for (int j = i + 1; j < u; j++)
                    rest -= load(column(j, i) + v * LANES) * load(right + j * TILE + v * LANES);
                const vec pivot = load(column(i, i) + v * LANES);
                const ivec flat = magnitude(pivot) < all(FLAT);
                const vec step = rest / choose(flat, all(1.0), pivot);
                store(right + i * TILE + v * LANES, choose(flat, all(0.0), step));
            }
    }
};

// Derivatives by parameters after reflecting; what only rounding left of a column is made zero.
static void reflect_without_rounding(const Reflections& reflections, double* part) {
    vec square[TV] = {};
    for (int i = 0; i < reflections.m; i++)
        EACH {
            const vec a = load(part + i * TILE + v * LANES);
            square[v] += a * a;
        }
    reflections.apply(part);
    vec least[TV];
    EACH least[v] = all(ROUNDED_AWAY) * root(square[v]);
    for (int i = 0; i < reflections.m; i++)
        EACH {
            double* const at = part + i * TILE + v * LANES;
            const vec a = load(at);
            store(at, choose(magnitude(a) < least[v], all(0.0), a));
        }
}

// Row minus its part in the span of orthonormal rows; overlaps: added to where they are wanted.
static void project(double* row, const double* basis, int rows, int K, double* overlaps) {
    for (int j = 0; j < rows; j++) {
        const double* const unit = basis + (ptrdiff_t)j * K * TILE;
        vec overlap[TV] = {};
        for (int k = 0; k < K; k++)
            EACH overlap[v] += load(row + k * TILE + v * LANES) * load(unit + k * TILE + v * LANES);
        for (int k = 0; k < K; k++)
            EACH {
                double* const at = row + k * TILE + v * LANES;
                store(at, load(at) - overlap[v] * load(unit + k * TILE + v * LANES));
            }
        EACH store(overlaps + j * TILE + v * LANES, overlap[v]);
    }
}

INLINE void squares(const double* row, int K, vec* length) {
    EACH length[v] = all(0.0);
    for (int k = 0; k < K; k++)
        EACH {
            const vec a = load(row + k * TILE + v * LANES);
            length[v] += a * a;
        }
}

// G = L Q^T with Q^T left in G (r, K); L: (r, r). A row of which little is left is swept twice,
// only for the poses where it is so: no pose depends on its neighbours.
static void orthonormalise(double* G, int r, int K, double* L, Room room, ivec* singular) {
    double* const row_again = room.rows(K);
    double* const more = room.rows(r);
    for (int i = 0; i < r; i++) {
        double* const row = G + (ptrdiff_t)i * K * TILE;
        double* const overlaps = L + (ptrdiff_t)i * r * TILE;
        project(row, G, i, K, overlaps);
        vec length[TV], before[TV];
        ivec again[TV], whether = {};
        squares(row, K, length);
        EACH before[v] = length[v];
        for (int j = 0; j < i; j++)
            EACH {
                const vec a = load(overlaps + j * TILE + v * LANES);
                before[v] += a * a;
            }
        EACH whether |= again[v] = ~(length[v] > all(REORTHOGONAL * REORTHOGONAL) * before[v]);
        if (__builtin_expect(any(whether), 0)) {
            memcpy(row_again, row, sizeof(double) * K * TILE);
            project(row_again, G, i, K, more);
            for (int j = 0; j < i; j++)
                EACH {
                    double* const at = overlaps + j * TILE + v * LANES;
                    store(at, choose(again[v], load(at) + load(more + j * TILE + v * LANES), load(at)));
                }
            for (int k = 0; k < K; k++)
                EACH {
                    double* const at = row + k * TILE + v * LANES;
                    store(at, choose(again[v], load(row_again + k * TILE + v * LANES), load(at)));
                }
            vec second[TV];
            squares(row, K, second);
            EACH {
                const ivec bad = again[v] & ~(second[v] > all(SINGULAR * SINGULAR) * before[v]);
                singular[v] |= bad;
                length[v] = choose(bad, all(1.0), second[v]);
            }
        }
        EACH {
            const vec whole = root(length[v]);
            store(overlaps + i * TILE + v * LANES, whole);
            length[v] = all(1.0) / whole;
        }
        for (int k = 0; k < K; k++)
            EACH {
                double* const at = row + k * TILE + v * LANES;
                store(at, load(at) * length[v]);
            }
    }
}

// L^-1 of lower triangles, (r, r)
static void invert(const double* L, int r, double* inverse) {
    for (int i = 0; i < r; i++) {
        EACH {
            const vec pivot = all(1.0) / load(L + ((ptrdiff_t)i * r + i) * TILE + v * LANES);
            store(inverse + ((ptrdiff_t)i * r + i) * TILE + v * LANES, pivot);
            for (int j = 0; j < i; j++) {
                vec total = {};
                for (int k = j; k < i; k++)
                    total += load(L + ((ptrdiff_t)i * r + k) * TILE + v * LANES) *
                             load(inverse + ((ptrdiff_t)k * r + j) * TILE + v * LANES);
                store(inverse + ((ptrdiff_t)i * r + j) * TILE + v * LANES, -pivot * total);
            }
        }
    }
}

// Rows of D, (n, r) at `out`: L^-1 times the derivatives by parameters, m views each, `skip` not.
template <int R>
static void whiten_columns(const View* D, int n, int m, int r, int skip, const double* inverse,
                           double* out) {
    const int rows = R ? R : r;
    EACH {
        for (int p = 0; p < n; p++) {
            const View* const column = D + (ptrdiff_t)p * m + skip;
            double* const to = out + (ptrdiff_t)p * rows * PIECE + v * LANES;
            for (int i = 0; i < rows; i++) {
                vec total = load(inverse + (ptrdiff_t)i * rows * TILE + v * LANES) * column[0][v];
                for (int j = 1; j <= i; j++)
                    total += load(inverse + ((ptrdiff_t)i * rows + j) * TILE + v * LANES) * column[j][v];
                store(to + i * PIECE, total);
            }
        }
    }
}

// What a tile is reduced from, as views: f (m), J (k, m), D (n, m); reflected where quantities are
// unmeasured.
struct Linear {
    View *f, *J, *D;
    Reflections reflections;
};

static View* views(Room& room, int count) {
    const int rows = (int)(((size_t)count * sizeof(View) + sizeof(double) * TILE - 1) / (sizeof(double) * TILE));
    return (View*)room.rows(rows);
}

static double* copied(Room& room, View* some, int m) {
    double* const part = room.rows(m);
    for (int i = 0; i < m; i++) {
        EACH store(part + i * TILE + v * LANES, some[i][v]);
        some[i] = view(part + i * TILE);
    }
    return part;
}

// What rounding does to a loop value: eps times the size of its terms, sum |df/dx| (1 + |reading|).
static void round_off(const Reduction& job, const Linear& part, int pose, int count, Room& room) {
    const int m = job.program->loops, k = job.program->inputs;
    double* const readings = room.rows(k);
    double* const sizes = room.rows(m);
    fill(readings, job.readings, k, pose, count);
    for (int i = 0; i < m; i++) {
        vec total[TV] = {};
        for (int q = 0; q < k; q++)
            EACH total[v] += magnitude(part.J[q * m + i][v]) *
                             (all(1.0) + magnitude(load(readings + q * TILE + v * LANES)));
        EACH store(sizes + i * TILE + v * LANES, all(EPSILON) * total[v]);
        part.f[i] = view(sizes + i * TILE);
    }
}

static Linear linear(const Reduction& job, const double* workspace, int pose, int count, Room& room) {
    const Program& program = *job.program;
    const Noise& noise = *job.noise;
    const int m = program.loops, k = program.quantities, u = noise.unmeasured_count;
    const int n = job.by_parameter ? program.parameters : 0;
    const int outputs = m * (1 + k + n);
    View* const all_views = views(room, outputs);
    for (int i = 0; i < outputs; i++) all_views[i] = view(workspace, program.outputs[i]);
    Linear found = {all_views, all_views + m, all_views + m * (1 + k), {u, m, nullptr, nullptr, nullptr}};
    if (job.rounding) round_off(job, found, pose, count, room);
    if (!u) return found;
    Reflections& reflections = found.reflections;
    reflections.vectors = room.rows(u * m);
    reflections.scales = room.rows(u);
    reflections.columns = room.rows(u * m);
    for (int j = 0; j < u; j++)
        for (int i = 0; i < m; i++)
            EACH store(reflections.column(j, i) + v * LANES, found.J[noise.unmeasured[j] * m + i][v]);
    reflections.triangularise();
    reflections.apply(copied(room, found.f, m));
    if (!job.exact)
        for (int i = 0; i < noise.measured_count; i++)
            reflections.apply(copied(room, found.J + noise.measured[i] * m, m));
    for (int i = 0; i < n; i++) reflect_without_rounding(reflections, copied(room, found.D + i * m, m));
    return found;
}

// The uncertainty of a tile: sds (k), what turns a step into sds (k), and the factors of covariances.
struct Uncertainty {
    double *sds, *inverse;
    double** factors;
};

static void fill_sds(const Noise& noise, int k, int pose, int count, const Uncertainty& to) {
    for (int q = 0; q < k; q++)
        for (int p = 0; p < TILE; p++) {
            const double sd = noise.sd[q * noise.row + (pose + (p < count ? p : count - 1)) * noise.by_pose];
            to.sds[q * TILE + p] = sd;
            to.inverse[q * TILE + p] = sd > 0.0 ? 1.0 / sd : 1.0;
        }
    for (int i = 0; i < noise.unmeasured_count; i++)
        for (int p = 0; p < TILE; p++) to.inverse[noise.unmeasured[i] * TILE + p] = 1.0 / UNMEASURED_SCALE;
}

static void fill_factor(const Covariance& block, int pose, int count, double* to) {
    for (int i = 0; i < block.size * block.size; i++)
        for (int p = 0; p < TILE; p++)
            to[i * TILE + p] = block.factor[(pose + (p < count ? p : count - 1)) * block.by_pose + i];
}

// Room for it, filled as far as it is the same for all poses.
static Uncertainty prepared(const Reduction& job, Room& room) {
    const Noise& noise = *job.noise;
    const int k = job.program->inputs;
    Uncertainty found = {room.rows(k), room.rows(k), (double**)room.rows(noise.block_count)};
    if (!noise.by_pose) fill_sds(noise, k, 0, 1, found);
    for (int b = 0; b < noise.block_count; b++) {
        found.factors[b] = room.rows(noise.blocks[b].size * noise.blocks[b].size);
        if (!noise.blocks[b].by_pose) fill_factor(noise.blocks[b], 0, 1, found.factors[b]);
    }
    return found;
}

static void fill_by_pose(const Reduction& job, int pose, int count, const Uncertainty& to) {
    const Noise& noise = *job.noise;
    if (noise.by_pose) fill_sds(noise, job.program->inputs, pose, count, to);
    for (int b = 0; b < noise.block_count; b++)
        if (noise.blocks[b].by_pose) fill_factor(noise.blocks[b], pose, count, to.factors[b]);
}

// G = J S, (r, K)
static void load_rows(const Reduction& job, const View* J, const Uncertainty& uncertainty, double* G) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, skip = noise.unmeasured_count, r = m - skip;
    const int K = noise.measured_count;
    for (int i = 0; i < r; i++)
        for (int k = 0; k < K; k++) {
            const View slope = J[noise.measured[k] * m + skip + i];
            const double* const sd = uncertainty.sds + noise.measured[k] * TILE;
            EACH store(G + ((ptrdiff_t)i * K + k) * TILE + v * LANES, slope[v] * load(sd + v * LANES));
        }
    for (int b = 0; b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int i = 0; i < r; i++)
            for (int d = 0; d < block.size; d++)
                EACH {
                    vec total = {};
                    for (int c = 0; c < block.size; c++)
                        total += J[noise.measured[block.places[c]] * m + skip + i][v] *
                                 load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES);
                    store(G + ((ptrdiff_t)i * K + block.places[d]) * TILE + v * LANES, total);
                }
    }
}

// correction = S Q E of the measured quantities, into rows of all quantities
static void unload(const Reduction& job, const double* G, const double* E, const Uncertainty& uncertainty,
                   double* normalised, double* correction) {
    const Noise& noise = *job.noise;
    const int K = noise.measured_count, r = job.program->loops - noise.unmeasured_count;
    for (int k = 0; k < K; k++) {
        vec total[TV] = {};
        for (int i = 0; i < r; i++)
            EACH total[v] += load(G + ((ptrdiff_t)i * K + k) * TILE + v * LANES) *
                             load(E + (ptrdiff_t)i * PIECE + v * LANES);
        const int q = noise.measured[k];
        EACH {
            store(normalised + k * TILE + v * LANES, total[v]);
            store(correction + q * TILE + v * LANES, total[v] * load(uncertainty.sds + q * TILE + v * LANES));
        }
    }
    for (int b = 0; b < noise.block_count; b++) {
        const Covariance& block = noise.blocks[b];
        for (int c = 0; c < block.size; c++)
            EACH {
                vec total = {};
                for (int d = 0; d < block.size; d++)
                    total += load(uncertainty.factors[b] + (c * block.size + d) * TILE + v * LANES) *
                             load(normalised + block.places[d] * TILE + v * LANES);
                store(correction + noise.measured[block.places[c]] * TILE + v * LANES, total);
            }
    }
}

// The whitened equations E and the corrections they lead to; E at `out`, D ahead of it.
static void whiten_uncertain(const Reduction& job, const Linear& part, const double* now,
                             const Uncertainty& uncertainty, Room room, double* out, double* correction,
                             ivec* singular) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, skip = noise.unmeasured_count, r = m - skip;
    const int K = noise.measured_count, n = job.by_parameter ? job.program->parameters : 0;
    double* const G = room.rows(r * K);
    double* const L = room.rows(r * r);
    double* const E = out + (ptrdiff_t)n * r * PIECE;
    load_rows(job, part.J, uncertainty, G);
    orthonormalise(G, r, K, L, room, singular);
    for (int i = 0; i < r; i++) {
        vec rest[TV] = {};
        for (int k = 0; k < K; k++) {
            const View slope = part.J[noise.measured[k] * m + skip + i];
            EACH rest[v] += slope[v] * load(now + noise.measured[k] * TILE + v * LANES);
        }
        EACH rest[v] -= part.f[skip + i][v];
        for (int j = 0; j < i; j++)
            EACH rest[v] -= load(L + ((ptrdiff_t)i * r + j) * TILE + v * LANES) *
                            load(E + (ptrdiff_t)j * PIECE + v * LANES);
        EACH store(E + (ptrdiff_t)i * PIECE + v * LANES,
                   rest[v] / load(L + ((ptrdiff_t)i * r + i) * TILE + v * LANES));
    }
    if (n && r) {
        double* const inverse = room.rows(r * r);
        invert(L, r, inverse);
        (r == 1   ? whiten_columns<1>
         : r == 2 ? whiten_columns<2>
         : r == 3 ? whiten_columns<3>
                  : whiten_columns<0>)(part.D, n, m, r, skip, inverse, out);
    }
    unload(job, G, E, uncertainty, room.rows(K), correction);
    if (!skip) return;
    double* const remainder = room.rows(skip);
    for (int i = 0; i < skip; i++)
        EACH {
            vec total = part.f[i][v];
            for (int k = 0; k < K; k++) {
                const int q = noise.measured[k];
                total += part.J[q * m + i][v] *
                         (load(correction + q * TILE + v * LANES) - load(now + q * TILE + v * LANES));
            }
            store(remainder + i * TILE + v * LANES, total);
        }
    part.reflections.solve(remainder);
    for (int i = 0; i < skip; i++)
        EACH {
            const int q = noise.unmeasured[i];
            store(correction + q * TILE + v * LANES,
                  load(now + q * TILE + v * LANES) - load(remainder + i * TILE + v * LANES));
        }
}

// The same for exact sensors: D = J_p, E = -f, and only unmeasured quantities are found.
static void leave_unweighted(const Reduction& job, const Linear& part, const double* now, Room room,
                             double* out, double* correction) {
    const Noise& noise = *job.noise;
    const int m = job.program->loops, k = job.program->quantities, skip = noise.unmeasured_count;
    const int r = m - skip, n = job.by_parameter ? job.program->parameters : 0;
    for (int p = 0; p < n; p++)
        for (int i = 0; i < r; i++)
            EACH store(out + ((ptrdiff_t)p * r + i) * PIECE + v * LANES, part.D[p * m + skip + i][v]);
    for (int i = 0; i < r; i++)
        EACH store(out + ((ptrdiff_t)n * r + i) * PIECE + v * LANES, -part.f[skip + i][v]);
    memcpy(correction, now, sizeof(double) * k * TILE);
    if (!skip) return;
    double* const steps = room.rows(skip);
    for (int i = 0; i < skip; i++) EACH store(steps + i * TILE + v * LANES, part.f[i][v]);
    part.reflections.solve(steps);
    for (int i = 0; i < skip; i++)
        EACH {
            double* const at = correction + noise.unmeasured[i] * TILE + v * LANES;
            store(at, load(at) - load(steps + i * TILE + v * LANES));
        }
}

// The longest move of each pose in sds; no number where one of them is none.
static void longest(const double* now, const double* correction, const double* inverse, int k, vec* most) {
    EACH most[v] = all(0.0);
    for (int q = 0; q < k; q++)
        EACH {
            const vec move = magnitude(load(correction + q * TILE + v * LANES) - load(now + q * TILE + v * LANES));
            const vec size = move * load(inverse + q * TILE + v * LANES);
            most[v] = choose((size > most[v]) | (size != size), size, most[v]);
        }
}

// Rows of D and E of the poses from `pose` on, `count` of them, to out (n + 1, r, PIECE).
static void whiten(const Reduction& job, int pose, int count, double* workspace, double* out,
                   const Uncertainty& uncertainty, Room room) {
    const Program& program = *job.program;
    const Noise& noise = *job.noise;
    const int k = program.inputs, r = program.loops - noise.unmeasured_count;
    const int width = job.by_parameter ? program.parameters + 1 : 1;
    double* const now = room.rows(k);
    double* const x = workspace + program.first;
    fill(x, job.readings, k, pose, count);
    fill(now, job.corrections, k, pose, count);
    fill(x + k * TILE, job.known, program.known, pose, count);
    for (int i = 0; i < k * TILE; i += LANES) store(x + i, load(x + i) + load(now + i));
    run(program, workspace, job.by_parameter ? 2 : 1);

    double* const correction = room.rows(k);
    fill_by_pose(job, pose, count, uncertainty);
    const Linear part = linear(job, workspace, pose, count, room);
    if (job.rounding) memset(now, 0, sizeof(double) * k * TILE);
    ivec singular[TV] = {};
    if (job.exact)
        leave_unweighted(job, part, now, room, out, correction);
    else
        whiten_uncertain(job, part, now, uncertainty, room, out, correction, singular);

    vec most[TV];
    longest(now, correction, uncertainty.inverse, k, most);
    for (int q = 0; q < k; q++)
        take_row(job.correction + q * job.correction_row + pose, correction + q * TILE, count);
    for (int p = 0; p < count; p++) {
        job.step[pose + p] = most[p / LANES][p % LANES];
        job.singular[pose + p] = singular[p / LANES][p % LANES] != 0;
    }
    if (count < TILE)
        for (int i = 0; i < width * r; i++)
            for (int p = count; p < TILE; p++) out[(ptrdiff_t)i * PIECE + p] = 0.0;
}
