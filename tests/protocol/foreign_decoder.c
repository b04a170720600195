/* A decoder of the wire in another language, written from protocol/README.md alone, whose tables of messages it reads.

   Usage: foreign_decoder README PORTION < streams. Each line of stdin is a stream in hex; it is fed to a fresh decoder
   PORTION bytes at a time, and one line of JSON says what came of it, in the form of the vectors. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_KEPT = 249, MOST_FIELDS = 32, MOST_MESSAGES = 64, MOST_LETTERS = 40 };

typedef struct {
    char name[MOST_LETTERS];
    char kind; /* u, i, or b: bytes */
    int size;  /* bytes of one number */
    int count; /* 0: a scalar */
} Field;

typedef struct {
    int id, fields, counted; /* counted: the last field is the row of a counted table */
    char name[MOST_LETTERS];
    Field field[MOST_FIELDS];
} Message;

static Message table[MOST_MESSAGES];
static int messages;

/* `u32`, `i16[3]`, `bytes[8]`, and behind `count x ` the row of a counted table. */
static void read_type(Message *message, Field *field, const char *type) {
    const char *row = strstr(type, "count x ");
    if (row) {
        message->counted = 1;
        type = row + strlen("count x ");
    }
    const char *array = strchr(type, '[');
    field->count = array ? atoi(array + 1) : 0;
    field->kind = type[0];
    field->size = type[0] == 'b' ? 1 : atoi(type + 1) / 8;
}

static void read_tables(FILE *readme) {
    char line[4096], name[MOST_LETTERS], type[MOST_LETTERS];
    unsigned id;
    Message *message = NULL;
    while (fgets(line, sizeof line, readme)) {
        if (sscanf(line, "#### 0x%x %39s", &id, name) == 2 && messages < MOST_MESSAGES) {
            message = &table[messages++];
            message->id = (int)id;
            strcpy(message->name, name);
        } else if (line[0] == '#') {
            message = NULL;
        } else if (message && sscanf(line, "| %*[0-9, ] | `%39[^`]` | %39[^|]|", name, type) == 2) {
            Field *field = &message->field[message->fields++];
            strcpy(field->name, name);
            read_type(message, field, type);
        }
    }
}

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

static int size_of(const Field *field) { return field->size * (field->count ? field->count : 1); }

static void print_number(char kind, int size, const uint8_t *at) {
    uint32_t value = 0;
    for (int i = 0; i < size; i++) value |= (uint32_t)at[i] << 8 * i;
    if (kind == 'u') {
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
    if (field->kind == 'b') {
        print_hex(at, field->count);
    } else if (!field->count) {
        print_number(field->kind, field->size, at);
    } else {
        putchar('[');
        for (int i = 0; i < field->count; i++) {
            if (i) printf(", ");
            print_number(field->kind, field->size, at + i * field->size);
        }
        putchar(']');
    }
}

/* Bytes of the payload that the fields take; -1 where it is too short for them. */
static int whole_size(const Message *message, const uint8_t *payload, int size) {
    int whole = 0;
    for (int i = 0; i < message->fields - message->counted; i++) whole += size_of(&message->field[i]);
    if (message->counted) {
        if (size < whole + 1) return -1;
        whole += 1 + payload[whole] * size_of(&message->field[message->fields - 1]);
    }
    return size < whole ? -1 : whole;
}

static void print_values(const Message *message, const uint8_t *payload) {
    putchar('{');
    for (int i = 0; i < message->fields; i++) {
        const Field *field = &message->field[i];
        printf("%s\"%s\": ", i ? ", " : "", field->name);
        if (!message->counted || i < message->fields - 1) {
            print_field(field, payload);
            payload += size_of(field);
            continue;
        }
        putchar('[');
        int count = *payload++;
        for (int row = 0; row < count; row++, payload += size_of(field)) {
            if (row) printf(", ");
            print_field(field, payload);
        }
        putchar(']');
    }
    putchar('}');
}

static void deliver(Decoder *decoder, const uint8_t *body, int size) {
    const uint8_t *payload = body + 4;
    const Message *message = NULL;
    int length = size - 6;
    for (int i = 0; i < messages; i++)
        if (table[i].id == body[0]) message = &table[i];
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
    FILE *readme = argc > 2 ? fopen(argv[1], "r") : NULL;
    if (!readme) {
        fprintf(stderr, "usage: foreign_decoder README PORTION < streams\n");
        return 2;
    }
    int portion = atoi(argv[2]);
    read_tables(readme);
    fclose(readme);
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
