// Group normalisation (or a scale and a shift of each channel), the rectifier, the sum with the identity and the first pooling of a
// ResNet, in as few passes over the images as there can be. Numbers of images are bfloat16, channels last, eight at a time; all else
// is single precision.
//
// x is what a convolution gave, (n, pixels, channels). Its affine map is z = a x + b, with a and b for each channel, and of group
// normalisation for each image too. Blocks are of 256 threads; blockIdx.y is the image, and blockIdx.x a share of its pixels.

typedef unsigned short half_t;
struct __attribute__((aligned(16))) eight { unsigned w[4]; };

__device__ __forceinline__ float low(unsigned w) { return __uint_as_float(w << 16); }
__device__ __forceinline__ float high(unsigned w) { return __uint_as_float(w & 0xffff0000u); }

// To the nearest, ties to even; NaN stays one.
__device__ __forceinline__ unsigned rounded(float x) {
  unsigned bits = __float_as_uint(x);
  if ((bits & 0x7fffffffu) > 0x7f800000u) return 0x7fffu;
  return (bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16;
}

__device__ __forceinline__ void load(const half_t* from, float* to) {
  eight all = *(const eight*)from;
#pragma unroll
  for (int i = 0; i < 4; i++) {
    to[2 * i] = low(all.w[i]);
    to[2 * i + 1] = high(all.w[i]);
  }
}

__device__ __forceinline__ void store(half_t* to, const float* from) {
  eight all;
#pragma unroll
  for (int i = 0; i < 4; i++) all.w[i] = rounded(from[2 * i]) | (rounded(from[2 * i + 1]) << 16);
  *(eight*)to = all;
}

__device__ __forceinline__ void load_floats(const float* from, float* to) {
#pragma unroll
  for (int i = 0; i < 8; i++) to[i] = from[i];
}

// The pixels of this thread: from first, in steps of step, to last.
struct Walk { int first, step, last, channel; };

__device__ __forceinline__ Walk walk(int pixels, int channels) {
  int threads = channels / 8;
  int share = (pixels + gridDim.x - 1) / gridDim.x;
  int begin = blockIdx.x * share, end = begin + share;
  Walk w;
  w.step = 256 / threads;
  w.first = begin + threadIdx.x / threads;
  w.last = end < pixels ? end : pixels;
  w.channel = (threadIdx.x % threads) * 8;
  return w;
}

// Sums of this block's pixels, for each channel: `one` and `other` of eight channels of each thread become
// part[image][share][channel] = (one, other).
__device__ __forceinline__ void gather(const float* one, const float* other, float* part, int channels) {
  __shared__ float sums[256 * 8];
  int threads = channels / 8, rows = 256 / threads;
  float* out = part + 2 * (size_t)channels * (blockIdx.y * gridDim.x + blockIdx.x);
  for (int turn = 0; turn < 2; turn++) {
    const float* mine = turn ? other : one;
    __syncthreads();
#pragma unroll
    for (int i = 0; i < 8; i++) sums[threadIdx.x * 8 + i] = mine[i];
    __syncthreads();
    for (int channel = threadIdx.x; channel < channels; channel += 256) {
      float sum = 0;
      for (int row = 0; row < rows; row++) sum += sums[row * channels + channel];
      out[2 * channel + turn] = sum;
    }
  }
}

// Sums of x and of its squares.
extern "C" __global__ void __launch_bounds__(256) sums(const half_t* x, float* part, int pixels, int channels) {
  float one[8] = {}, other[8] = {}, v[8];
  Walk w = walk(pixels, channels);
  const half_t* image = x + (size_t)blockIdx.y * pixels * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    load(image + (size_t)p * channels, v);
#pragma unroll
    for (int i = 0; i < 8; i++) {
      one[i] += v[i];
      other[i] = fmaf(v[i], v[i], other[i]);
    }
  }
  gather(one, other, part, channels);
}

// The affine map of group normalisation, sixteen channels a group: maps[image][0 or 1][channel] = a or b; and stat[image][channel] =
// (mean, 1 / deviation). A block an image.
extern "C" __global__ void __launch_bounds__(256) group_maps(const float* part, const half_t* gamma, const half_t* beta, float* maps,
                                                             float* stat, int pixels, int channels, int shares) {
  __shared__ float one[512], other[512];
  int image = blockIdx.x;
  for (int c = threadIdx.x; c < channels; c += 256) {
    float s = 0, q = 0;
    for (int share = 0; share < shares; share++) {
      const float* p = part + 2 * ((size_t)channels * (image * shares + share) + c);
      s += p[0];
      q += p[1];
    }
    one[c] = s;
    other[c] = q;
  }
  __syncthreads();
  for (int c = threadIdx.x; c < channels; c += 256) {
    int group = c / 16 * 16;
    float s = 0, q = 0;
    for (int i = group; i < group + 16; i++) {
      s += one[i];
      q += other[i];
    }
    float count = 16.0f * pixels, mean = s / count;
    float variance = fmaxf(q / count - mean * mean, 0.0f);
    float inverse = 1.0f / sqrtf(variance + 1e-5f);
    float a = inverse * low(gamma[c]);
    maps[(2 * image) * channels + c] = a;
    maps[(2 * image + 1) * channels + c] = fmaf(-mean, a, low(beta[c]));
    stat[2 * (image * channels + c)] = mean;
    stat[2 * (image * channels + c) + 1] = inverse;
  }
}

// y = a x + b, plus `identity` if there is one, rectified if asked. `each` says that images have maps of their own.
extern "C" __global__ void __launch_bounds__(256) forward(const half_t* x, const float* maps, const half_t* identity, half_t* y, int pixels,
                                                          int channels, int each, int rectified) {
  float a[8], b[8], v[8], r[8];
  Walk w = walk(pixels, channels);
  const float* map = maps + (each ? 2 * (size_t)blockIdx.y * channels : 0) + w.channel;
  load_floats(map, a);
  load_floats(map + channels, b);
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    size_t here = at + (size_t)p * channels;
    load(x + here, v);
#pragma unroll
    for (int i = 0; i < 8; i++) v[i] = fmaf(a[i], v[i], b[i]);
    if (identity) {
      load(identity + here, r);
#pragma unroll
      for (int i = 0; i < 8; i++) v[i] += r[i];
    }
    if (rectified) {
#pragma unroll
      for (int i = 0; i < 8; i++) v[i] = v[i] < 0.0f ? 0.0f : v[i];
    }
    store(y + here, v);
  }
}

// The gradient of z at one pixel: that of y, `d`, where the rectifier let it through. It did where y is not zero; without y
// (there was no identity) that is where z is not.
__device__ __forceinline__ void let_through(float* d, const float* v, const half_t* y, size_t here, const float* a, const float* b,
                                            int rectified) {
  if (!rectified) return;
  float kept[8];
  if (y) {
    load(y + here, kept);
  } else {
#pragma unroll
    for (int i = 0; i < 8; i++) kept[i] = fmaf(a[i], v[i], b[i]);
  }
#pragma unroll
  for (int i = 0; i < 8; i++) d[i] = kept[i] > 0.0f ? d[i] : 0.0f;
}

// Sums of the gradient of z and of its product with x.
extern "C" __global__ void __launch_bounds__(256) backward_sums(const half_t* dy, const half_t* y, const half_t* x, const float* maps,
                                                                float* part, int pixels, int channels, int each, int rectified) {
  float one[8] = {}, other[8] = {}, a[8], b[8], v[8], d[8];
  Walk w = walk(pixels, channels);
  const float* map = maps + (each ? 2 * (size_t)blockIdx.y * channels : 0) + w.channel;
  load_floats(map, a);
  load_floats(map + channels, b);
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    size_t here = at + (size_t)p * channels;
    load(x + here, v);
    load(dy + here, d);
    let_through(d, v, y, here, a, b, rectified);
#pragma unroll
    for (int i = 0; i < 8; i++) {
      one[i] += d[i];
      other[i] = fmaf(d[i], v[i], other[i]);
    }
  }
  gather(one, other, part, channels);
}

// Of group normalisation: dx = k dz + l x + m, back[image][0, 1 or 2][channel]; and what an image adds to the gradients of beta and
// gamma, added[image][channel]. A block an image.
extern "C" __global__ void __launch_bounds__(256) backward_maps(const float* part, const float* stat, const half_t* gamma, float* back,
                                                                float* added, int pixels, int channels, int shares) {
  __shared__ float one[512], other[512];
  int image = blockIdx.x;
  for (int c = threadIdx.x; c < channels; c += 256) {
    float s = 0, q = 0;
    for (int share = 0; share < shares; share++) {
      const float* p = part + 2 * ((size_t)channels * (image * shares + share) + c);
      s += p[0];
      q += p[1];
    }
    float mean = stat[2 * (image * channels + c)], inverse = stat[2 * (image * channels + c) + 1];
    float scaled = (q - mean * s) * inverse;
    added[2 * (image * channels + c)] = s;
    added[2 * (image * channels + c) + 1] = scaled;
    one[c] = s * low(gamma[c]);
    other[c] = scaled * low(gamma[c]);
  }
  __syncthreads();
  for (int c = threadIdx.x; c < channels; c += 256) {
    int group = c / 16 * 16;
    float s = 0, q = 0;
    for (int i = group; i < group + 16; i++) {
      s += one[i];
      q += other[i];
    }
    float count = 16.0f * pixels;
    float mean = stat[2 * (image * channels + c)], inverse = stat[2 * (image * channels + c) + 1];
    float l = -inverse * inverse * q / count;
    float* out = back + 3 * (size_t)image * channels + c;
    out[0] = inverse * low(gamma[c]);
    out[channels] = l;
    out[2 * channels] = -inverse * s / count - l * mean;
  }
}

// The gradients of gamma and beta: `added` over all images.
extern "C" __global__ void __launch_bounds__(256) parameters(const float* added, half_t* gamma, half_t* beta, int images, int channels) {
  int c = blockIdx.x * 256 + threadIdx.x;
  if (c >= channels) return;
  float s = 0, q = 0;
  for (int image = 0; image < images; image++) {
    s += added[2 * (image * channels + c)];
    q += added[2 * (image * channels + c) + 1];
  }
  beta[c] = rounded(s);
  gamma[c] = rounded(q);
}

// dx = k dz + l x + m, or a dz if there is no `back`; and dz itself if that is asked for.
extern "C" __global__ void __launch_bounds__(256) backward(const half_t* dy, const half_t* y, const half_t* x, const float* maps,
                                                           const float* back, half_t* dx, half_t* dz, int pixels, int channels, int each,
                                                           int rectified) {
  float a[8], b[8], k[8], l[8], m[8], v[8], d[8];
  Walk w = walk(pixels, channels);
  const float* map = maps + (each ? 2 * (size_t)blockIdx.y * channels : 0) + w.channel;
  load_floats(map, a);
  load_floats(map + channels, b);
  if (back) {
    const float* from = back + 3 * (size_t)blockIdx.y * channels + w.channel;
    load_floats(from, k);
    load_floats(from + channels, l);
    load_floats(from + 2 * channels, m);
  }
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  bool reads_x = back || (rectified && !y);
  for (int p = w.first; p < w.last; p += w.step) {
    size_t here = at + (size_t)p * channels;
    if (reads_x) load(x + here, v);
    load(dy + here, d);
    let_through(d, v, y, here, a, b, rectified);
    if (dz) store(dz + here, d);
#pragma unroll
    for (int i = 0; i < 8; i++) d[i] = back ? fmaf(k[i], d[i], fmaf(l[i], v[i], m[i])) : a[i] * d[i];
    store(dx + here, d);
  }
}

// The affine map, the greatest of three by three pixels two apart, and the rectifier; `which` says which of the nine it was.
extern "C" __global__ void __launch_bounds__(256) pooled(const half_t* x, const float* maps, half_t* y, unsigned char* which, int high_in,
                                                         int wide_in, int channels, int each) {
  float a[8], b[8], v[8], best[8];
  int high_out = (high_in + 1) / 2, wide_out = (wide_in + 1) / 2, pixels = high_out * wide_out;
  Walk w = walk(pixels, channels);
  const float* map = maps + (each ? 2 * (size_t)blockIdx.y * channels : 0) + w.channel;
  load_floats(map, a);
  load_floats(map + channels, b);
  const half_t* image = x + (size_t)blockIdx.y * high_in * wide_in * channels + w.channel;
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    int row = 2 * (p / wide_out) - 1, column = 2 * (p % wide_out) - 1;
    unsigned long long chosen = 0;
#pragma unroll
    for (int i = 0; i < 8; i++) best[i] = -3.4e38f;
    for (int tap = 0; tap < 9; tap++) {
      int r = row + tap / 3, c = column + tap % 3;
      if (r < 0 || c < 0 || r >= high_in || c >= wide_in) continue;
      load(image + ((size_t)r * wide_in + c) * channels, v);
#pragma unroll
      for (int i = 0; i < 8; i++) {
        float z = fmaf(a[i], v[i], b[i]);
        // A NaN is the greatest.
        if (!(z <= best[i])) {
          best[i] = z;
          chosen = (chosen & ~(0xffull << (8 * i))) | ((unsigned long long)tap << (8 * i));
        }
      }
    }
#pragma unroll
    for (int i = 0; i < 8; i++) best[i] = best[i] < 0.0f ? 0.0f : best[i];
    size_t here = at + (size_t)p * channels;
    store(y + here, best);
    *(unsigned long long*)(which + here) = chosen;
  }
}

// Sums of the gradient of z before the pooling and of its product with x.
extern "C" __global__ void __launch_bounds__(256) pooled_backward_sums(const half_t* dy, const half_t* y, const unsigned char* which,
                                                                       const half_t* x, float* part, int high_in, int wide_in,
                                                                       int channels) {
  float one[8] = {}, other[8] = {}, kept[8], d[8];
  int high_out = (high_in + 1) / 2, wide_out = (wide_in + 1) / 2, pixels = high_out * wide_out;
  Walk w = walk(pixels, channels);
  const half_t* image = x + (size_t)blockIdx.y * high_in * wide_in * channels + w.channel;
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    int row = 2 * (p / wide_out) - 1, column = 2 * (p % wide_out) - 1;
    size_t here = at + (size_t)p * channels;
    load(dy + here, d);
    load(y + here, kept);
    unsigned long long chosen = *(const unsigned long long*)(which + here);
#pragma unroll
    for (int i = 0; i < 8; i++) {
      int tap = (int)(chosen >> (8 * i)) & 15;
      float g = kept[i] > 0.0f ? d[i] : 0.0f;
      float v = low(image[((size_t)(row + tap / 3) * wide_in + column + tap % 3) * channels + i]);
      one[i] += g;
      other[i] = fmaf(g, v, other[i]);
    }
  }
  gather(one, other, part, channels);
}

// dx before the pooling: k dz + l x + m, or a dz if there is no `back`.
extern "C" __global__ void __launch_bounds__(256) pooled_backward(const half_t* dy, const half_t* y, const unsigned char* which,
                                                                  const half_t* x, const float* maps, const float* back, half_t* dx,
                                                                  int high_in, int wide_in, int channels, int each) {
  float a[8], k[8], l[8], m[8], v[8], d[8], g[8], kept[8];
  int high_out = (high_in + 1) / 2, wide_out = (wide_in + 1) / 2, pixels = high_in * wide_in;
  Walk w = walk(pixels, channels);
  load_floats(maps + (each ? 2 * (size_t)blockIdx.y * channels : 0) + w.channel, a);
  if (back) {
    const float* from = back + 3 * (size_t)blockIdx.y * channels + w.channel;
    load_floats(from, k);
    load_floats(from + channels, l);
    load_floats(from + 2 * channels, m);
  }
  size_t at = (size_t)blockIdx.y * pixels * channels + w.channel;
  size_t at_out = (size_t)blockIdx.y * high_out * wide_out * channels + w.channel;
  for (int p = w.first; p < w.last; p += w.step) {
    int row = p / wide_in, column = p % wide_in;
#pragma unroll
    for (int i = 0; i < 8; i++) g[i] = 0.0f;
    // The windows that this pixel is in: those whose middle is at most one away.
    for (int r = row / 2; r <= (row + 1) / 2 && r < high_out; r++) {
      for (int c = column / 2; c <= (column + 1) / 2 && c < wide_out; c++) {
        unsigned tap = (unsigned)((row - 2 * r + 1) * 3 + column - 2 * c + 1);
        size_t there = at_out + (size_t)(r * wide_out + c) * channels;
        unsigned long long chosen = *(const unsigned long long*)(which + there);
        load(dy + there, d);
        load(y + there, kept);
#pragma unroll
        for (int i = 0; i < 8; i++) {
          if (((unsigned)(chosen >> (8 * i)) & 15u) == tap && kept[i] > 0.0f) g[i] += d[i];
        }
      }
    }
    size_t here = at + (size_t)p * channels;
    if (back) load(x + here, v);
#pragma unroll
    for (int i = 0; i < 8; i++) g[i] = back ? fmaf(k[i], g[i], fmaf(l[i], v[i], m[i])) : a[i] * g[i];
    store(dx + here, g);
  }
}
