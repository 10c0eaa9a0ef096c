#define LANES 8
#include "width.inc"

const loopcal::Width loopcal::width_8 = {"AVX-512", loopcal::room, loopcal::evaluate, loopcal::reduce, loopcal::close, loopcal::search};
