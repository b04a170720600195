/* A decoder of the wire in another language, written from protocol/README.md alone.

   Usage: foreign_decoder PORTION < streams. Each line of stdin is a stream in hex; it is fed to a fresh decoder
   PORTION bytes at a time, and one line of JSON says what came of it, in the form of the vectors. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_KEPT = 249, MOST_FIELDS = 24 };

typedef struct { /* type: u U i I and digits as in the table, x: bytes; count 0: a scalar */
    const char *name, *type;
    int count;
} Field;

typedef struct {
    int id;
    const char *name;
    Field fields[MOST_FIELDS];
    Field rows; /* name NULL: no counted table */
} Message;

static const Message TABLE[] = {
    {0x01, "Hello",
     {{"fingerprint", "u4", 0}, {"firmware", "u1", 3}, {"serial", "x", 8}, {"boot_id", "u2", 0},
      {"board", "u1", 0}, {"reset_cause", "u1", 0}, {"rate_mhz", "u4", 0}, {"gyro_range_dps", "u2", 0},
      {"accel_range_g", "u1", 0}, {"gyro_lsb_ndps", "u4", 0}, {"accel_lsb_ng", "u4", 0},
      {"temperature_lsb_udegc", "u4", 0}, {"temperature_offset_udegc", "i4", 0}, {"mag_lsb_ft", "u4", 0},
      {"batch", "u1", 0}, {"filter_kind", "u1", 0}, {"stamp_bound_us", "u2", 0}},
     {"parts", "u1", 3}},
    {0x02, "ImuBatch",
     {{"t_us", "u4", 0}, {"period_ns", "u4", 0}, {"index", "u2", 0}, {"temperature_raw", "i2", 0},
      {"flags", "u1", 0}},
     {"samples", "i2", 6}},
    {0x03, "Mag", {{"t_us", "u4", 0}, {"field_raw", "i2", 3}}, {0}},
    {0x04, "Filter",
     {{"t_us", "u4", 0}, {"state", "u1", 0}, {"saturations", "u2", 0}, {"samples", "u4", 0},
      {"rate_q8", "i4", 3}, {"bias_q12", "i4", 3}, {"variance_q8", "u4", 3}, {"bias_sigma_q12", "u4", 3}},
     {0}},
    {0x05, "Health",
     {{"t_us", "u4", 0}, {"battery_mv", "u2", 0}, {"faults", "u2", 0}, {"i2c_errors", "u2", 0},
      {"bus_recoveries", "u2", 0}, {"fifo_overruns", "u2", 0}, {"samples_missed", "u2", 0},
      {"frames_dropped", "u2", 0}, {"frames_damaged", "u2", 0}, {"queue_high_water", "u1", 0},
      {"worst_loop_us", "u4", 0}, {"reset_cause", "u1", 0}, {"free_heap", "u4", 0}, {"stamp_bound_us", "u2", 0},
      {"battery_percent", "u1", 0}},
     {0}},
    {0x06, "Ack", {{"request", "u1", 0}, {"request_seq", "u2", 0}}, {0}},
    {0x07, "Nack", {{"request", "u1", 0}, {"request_seq", "u2", 0}, {"reason", "u1", 0}, {"detail", "i4", 0}}, {0}},
    {0x08, "TimeReply", {{"token", "x", 8}, {"received_us", "u4", 0}, {"sent_us", "u4", 0}}, {0}},
    {0x09, "Signal",
     {{"t_us", "u4", 0}, {"of_node", "u1", 0}, {"frames", "u4", 0}, {"frames_lost", "u4", 0}, {"pieces", "u4", 0},
      {"pieces_twice", "u4", 0}, {"pieces_strong", "u4", 0}, {"rssi_dbm", "i1", 0}, {"requests_dropped", "u2", 0}},
     {0}},
    {0x41, "TimeRequest", {{"token", "x", 8}}, {0}},
    {0x42, "Ping", {{0}}, {0}},
    {0x43, "SetConfig", {{"key", "u1", 0}, {"value", "i4", 0}}, {0}},
    {0x44, "Start", {{0}}, {0}},
    {0x45, "Stop", {{0}}, {0}},
    {0x46, "BiasInit", {{"samples", "u2", 0}}, {0}},
    {0x47, "Reboot", {{"mode", "u1", 0}}, {0}},
    {0x48, "GetHello", {{0}}, {0}},
};

typedef struct {
    uint8_t kept[MOST_KEPT];
    int pending, skipping, frames;
    long crc, cobs, too_short, oversize, bytes_lost, idle;
} Decoder;

static uint16_t crc16(const uint8_t *data, int size) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < size; i++) {
        crc ^= (uint16_t)(data[i] << 8);
        for (int bit = 0; bit < 8; bit++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* Size of the body, or -1 where a code leads outside. */
static int unstuff(const uint8_t *in, int size, uint8_t *out) {
    int at = 0, made = 0;
    while (at < size) {
        int code = in[at];
        if (at + code > size) return -1;
        memcpy(out + made, in + at + 1, (size_t)code - 1);
        made += code - 1;
        at += code;
        if (at < size) out[made++] = 0;
    }
    return made;
}

static int size_of(const Field *field) {
    int one = field->type[0] == 'x' ? 1 : field->type[1] - '0';
    return one * (field->count ? field->count : 1);
}

static void print_number(const char *type, const uint8_t *at) {
    int size = type[1] - '0';
    uint32_t value = 0;
    for (int i = 0; i < size; i++) value |= (uint32_t)at[i] << 8 * i;
    if (type[0] == 'u') {
        printf("%lu", (unsigned long)value);
    } else {
        long whole = (long)value;
        if (value >> (8 * size - 1)) whole -= (long)1 << 8 * size;
        printf("%ld", whole);
    }
}

static void print_hex(const uint8_t *at, int size) {
    putchar('"');
    for (int i = 0; i < size; i++) printf("%02x", at[i]);
    putchar('"');
}

static void print_field(const Field *field, const uint8_t *at) {
    if (field->type[0] == 'x') {
        print_hex(at, field->count);
    } else if (!field->count) {
        print_number(field->type, at);
    } else {
        putchar('[');
        for (int i = 0; i < field->count; i++) {
            if (i) printf(", ");
            print_number(field->type, at + i * (field->type[1] - '0'));
        }
        putchar(']');
    }
}

/* Bytes of the fields before a counted table, and of the whole with it; -1 where the payload is too short. */
static int fixed_size(const Message *message) {
    int size = 0;
    for (const Field *f = message->fields; f->name; f++) size += size_of(f);
    return size;
}

static int whole_size(const Message *message, const uint8_t *payload, int size) {
    int fixed = fixed_size(message);
    if (!message->rows.name) return size < fixed ? -1 : fixed;
    if (size < fixed + 1) return -1;
    int whole = fixed + 1 + payload[fixed] * size_of(&message->rows);
    return size < whole ? -1 : whole;
}

static void print_values(const Message *message, const uint8_t *payload) {
    const char *comma = "";
    putchar('{');
    for (const Field *f = message->fields; f->name; f++, comma = ", ") {
        printf("%s\"%s\": ", comma, f->name);
        print_field(f, payload);
        payload += size_of(f);
    }
    if (message->rows.name) {
        int count = *payload++;
        printf("%s\"%s\": [", comma, message->rows.name);
        for (int i = 0; i < count; i++, payload += size_of(&message->rows)) {
            if (i) printf(", ");
            print_field(&message->rows, payload);
        }
        putchar(']');
    }
    putchar('}');
}

static void deliver(Decoder *decoder, const uint8_t *body, int size) {
    const uint8_t *payload = body + 4;
    const Message *message = NULL;
    int length = size - 6;
    for (size_t i = 0; i < sizeof TABLE / sizeof *TABLE; i++)
        if (TABLE[i].id == body[0]) message = &TABLE[i];
    int malformed = message && whole_size(message, payload, length) < 0;
    printf("%s{\"type\": %d, \"node\": %d, \"seq\": %d, \"payload\": ", decoder->frames++ ? ", " : "", body[0],
           body[1], body[2] | body[3] << 8);
    print_hex(payload, length);
    if (!message || malformed) {
        printf(", \"message\": null, \"values\": null%s}", malformed ? ", \"malformed\": true" : "");
        return;
    }
    printf(", \"message\": \"%s\", \"values\": ", message->name);
    print_values(message, payload);
    putchar('}');
}

static void ended(Decoder *decoder) {
    uint8_t body[MOST_KEPT];
    int size = unstuff(decoder->kept, decoder->pending, body);
    long *cause = NULL;
    if (size < 0) cause = &decoder->cobs;
    else if (size < 6) cause = &decoder->too_short;
    else if (crc16(body, size - 2) != (body[size - 2] | body[size - 1] << 8)) cause = &decoder->crc;
    if (cause) {
        ++*cause;
        decoder->bytes_lost += decoder->pending + 1;
    } else {
        deliver(decoder, body, size);
    }
    decoder->pending = 0;
}

static void feed(Decoder *decoder, const uint8_t *data, int size) {
    for (int i = 0; i < size; i++) {
        if (decoder->skipping) {
            decoder->bytes_lost++;
            decoder->skipping = data[i] != 0;
        } else if (!data[i] && !decoder->pending) {
            decoder->idle++;
        } else if (!data[i]) {
            ended(decoder);
        } else if (decoder->pending == MOST_KEPT) {
            decoder->oversize++;
            decoder->bytes_lost += MOST_KEPT + 1;
            decoder->pending = 0;
            decoder->skipping = 1;
        } else {
            decoder->kept[decoder->pending++] = data[i];
        }
    }
}

int main(int argc, char **argv) {
    int portion = argc > 1 ? atoi(argv[1]) : 1;
    static char line[1 << 20];
    static uint8_t stream[1 << 19];
    while (fgets(line, sizeof line, stdin)) {
        Decoder decoder = {0};
        int size = 0;
        unsigned byte;
        while (sscanf(line + 2 * size, "%2x", &byte) == 1) stream[size++] = (uint8_t)byte;
        printf("{\"frames\": [");
        for (int at = 0; at < size; at += portion)
            feed(&decoder, stream + at, at + portion < size ? portion : size - at);
        printf("], \"damage\": {\"crc\": %ld, \"cobs\": %ld, \"short\": %ld, \"oversize\": %ld, \"cut\": 0, "
               "\"bytes_lost\": %ld}, \"idle_delimiters\": %ld, \"pending\": %d}\n",
               decoder.crc, decoder.cobs, decoder.too_short, decoder.oversize, decoder.bytes_lost, decoder.idle,
               decoder.pending);
    }
    return 0;
}
