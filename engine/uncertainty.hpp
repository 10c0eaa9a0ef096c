constexpr double UNMEASURED_SCALE = 1e-3;

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

static Uncertainty uncertainty_rows(const Noise& noise, int k, Room& room) {
    const Uncertainty found = {room.rows(k), room.rows(k), (double**)room.rows(noise.block_count)};
    for (int b = 0; b < noise.block_count; b++) {
        double* const factor = room.rows(noise.blocks[b].size * noise.blocks[b].size);
        if (found.factors) found.factors[b] = factor;
    }
    return found;
}

// Filled as far as it is the same for all poses.
static void prepare(const Noise& noise, int k, const Uncertainty& to) {
    if (!noise.by_pose) fill_sds(noise, k, 0, 1, to);
    for (int b = 0; b < noise.block_count; b++)
        if (!noise.blocks[b].by_pose) fill_factor(noise.blocks[b], 0, 1, to.factors[b]);
}

static void fill_by_pose(const Noise& noise, int k, int pose, int count, const Uncertainty& to) {
    if (noise.by_pose) fill_sds(noise, k, pose, count, to);
    for (int b = 0; b < noise.block_count; b++)
        if (noise.blocks[b].by_pose) fill_factor(noise.blocks[b], pose, count, to.factors[b]);
}
