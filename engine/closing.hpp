// Readings of each pose of a tile corrected until its loops close, by Gauss-Newton: what
// loopcal/estimation/solve/gauss_newton.py says, in its order. A pose that has settled waits for the others.

constexpr double SHORTEST = 1e-3, STUCK_AT = 0.25;

// Rows (k) of a tile that is closed.
struct Steps {
    double *start, *at, *base, *step, *correction, *done;
};

static Steps steps(int k, Room& room) {
    return {room.rows(k), room.rows(k), room.rows(k), room.rows(k), room.rows(k), room.rows(k)};
}

static void close_tile(const Closing& job, int pose, int count, double* workspace, const Linear& part,
                       const Uncertainty& uncertainty, double* out, const Whitening& whitening, const Steps& to) {
    const Reduction& reduction = job.reduction;
    const int k = part.program->inputs;
    double *const start = to.start, *const at = to.at, *const base = to.base;
    double *const step = to.step, *const correction = to.correction, *const done = to.done;
    fill(start, reduction.corrections, k, pose, count);
    fill_by_pose(*reduction.noise, k, pose, count, uncertainty);
    // the start is a step from the readings, halved where it leaves the domain of a loop
    memcpy(at, start, sizeof(double) * k * TILE);
    memcpy(step, start, sizeof(double) * k * TILE);
    memset(base, 0, sizeof(double) * k * TILE);
    const vec tolerance = all(job.tolerance), least = all(job.tolerance > NEGLIGIBLE ? job.tolerance : NEGLIGIBLE);
    vec length[TV], expected[TV], last[TV], ratio[TV], rounds[TV];
    ivec active[TV], overshot[TV], finished[TV];
    EACH {
        length[v] = all(1.0), expected[v] = all(INFINITY);
        last[v] = ratio[v] = rounds[v] = all(0.0);
        active[v] = ~ivec{};
    }
    for (int round = 0; round < MOST_CLOSINGS; round++) {
        vec size[TV];
        ivec singular[TV] = {}, left = {};
        whiten_at(reduction, at, pose, count, workspace, part, uncertainty, whitening, out, correction, size, singular);
        EACH {
            const vec twice = all(2.0) * expected[v];
            // A step larger than the one before, or one that is no number, overshot: halve it.
            overshot[v] = ~(size[v] <= choose(twice < least, least, twice)) & (length[v] > all(SHORTEST));
            const ivec first = expected[v] == all(INFINITY);
            const vec rate = choose(first, all(job.contraction), size[v] / expected[v]);
            const ivec stuck = (expected[v] <= all(NEGLIGIBLE)) & (size[v] > all(STUCK_AT) * expected[v]);  // by rounding
            finished[v] = active[v] & ~overshot[v] & ((size[v] * rate <= tolerance) | stuck);
            ratio[v] = choose(active[v] & ~first & (rate > ratio[v]), rate, ratio[v]);
            last[v] = choose(finished[v], size[v], last[v]);
            rounds[v] += choose(active[v], all(1.0), all(0.0));
            active[v] &= ~finished[v];
            length[v] = choose(overshot[v], all(0.5) * length[v], all(1.0));
            expected[v] = choose(overshot[v], expected[v], size[v]);
            left |= active[v];
        }
        take_where(finished, correction, k, done);
        if (!any(left)) break;
        for (int q = 0; q < k; q++)
            EACH {
                const ptrdiff_t i = q * TILE + v * LANES;
                const ivec moves = active[v] & ~overshot[v];
                const vec now = load(at + i), from = choose(moves, now, load(base + i));
                const vec whole = choose(moves, load(correction + i) - now, load(step + i));
                store(base + i, from);
                store(step + i, whole);
                store(at + i, choose(active[v], from + length[v] * whole, now));
            }
    }
    for (int q = 0; q < k; q++)
        EACH {
            const ptrdiff_t i = q * TILE + v * LANES;
            const vec from = load(base + i), near = choose(magnitude(from) < all(INFINITY), from, load(start + i));
            store(done + i, choose(active[v], near, load(done + i)));
        }
    for (int q = 0; q < k; q++) take_row(reduction.correction + q * reduction.correction_row + pose, done + q * TILE, count);
    for (int p = 0; p < count; p++) {
        const int v = p / LANES, lane = p % LANES;
        reduction.step[pose + p] = last[v][lane];
        job.ratio[pose + p] = ratio[v][lane];
        job.rounds[pose + p] = (int32_t)rounds[v][lane];
        job.open[pose + p] = active[v][lane] != 0;
    }
}
