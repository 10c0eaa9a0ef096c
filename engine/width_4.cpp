#define LANES 4
#include "width.inc"

const loopcal::Width loopcal::width_4 = {"AVX2", loopcal::room, loopcal::evaluate, loopcal::reduce, loopcal::close, loopcal::search};
