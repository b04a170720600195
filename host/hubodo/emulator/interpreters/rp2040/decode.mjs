// Table of the ARMv6-M instruction of every halfword; the fast core switches on it.

const FORMS = [
  // Name, shift, remaining bits: encodings of the ARMv6-M manual, chapter A5.
  ["LSL_I", 11, 0b00000], ["LSR_I", 11, 0b00001], ["ASR_I", 11, 0b00010],
  ["ADD_R", 9, 0b0001100], ["SUB_R", 9, 0b0001101], ["ADD_3", 9, 0b0001110], ["SUB_3", 9, 0b0001111],
  ["MOV_I", 11, 0b00100], ["CMP_I", 11, 0b00101], ["ADD_8", 11, 0b00110], ["SUB_8", 11, 0b00111],
  ["AND", 6, 0b0100000000], ["EOR", 6, 0b0100000001], ["LSL_R", 6, 0b0100000010], ["LSR_R", 6, 0b0100000011],
  ["ASR_R", 6, 0b0100000100], ["ADC", 6, 0b0100000101], ["SBC", 6, 0b0100000110], ["ROR", 6, 0b0100000111],
  ["TST", 6, 0b0100001000], ["RSB", 6, 0b0100001001], ["CMP_R", 6, 0b0100001010], ["CMN", 6, 0b0100001011],
  ["ORR", 6, 0b0100001100], ["MUL", 6, 0b0100001101], ["BIC", 6, 0b0100001110], ["MVN", 6, 0b0100001111],
  ["ADD_H", 8, 0b01000100], ["CMP_H", 8, 0b01000101], ["MOV_H", 8, 0b01000110], ["BX", 7, 0b010001110],
  ["BLX", 7, 0b010001111], ["LDR_L", 11, 0b01001],
  ["STR_R", 9, 0b0101000], ["STRH_R", 9, 0b0101001], ["STRB_R", 9, 0b0101010], ["LDRSB", 9, 0b0101011],
  ["LDR_R", 9, 0b0101100], ["LDRH_R", 9, 0b0101101], ["LDRB_R", 9, 0b0101110], ["LDRSH", 9, 0b0101111],
  ["STR_I", 11, 0b01100], ["LDR_I", 11, 0b01101], ["STRB_I", 11, 0b01110], ["LDRB_I", 11, 0b01111],
  ["STRH_I", 11, 0b10000], ["LDRH_I", 11, 0b10001], ["STR_S", 11, 0b10010], ["LDR_S", 11, 0b10011],
  ["ADR", 11, 0b10100], ["ADD_S", 11, 0b10101], ["INC_S", 7, 0b101100000], ["DEC_S", 7, 0b101100001],
  ["SXTH", 6, 0b1011001000], ["SXTB", 6, 0b1011001001], ["UXTH", 6, 0b1011001010], ["UXTB", 6, 0b1011001011],
  ["PUSH", 9, 0b1011010], ["POP", 9, 0b1011110], ["REV", 6, 0b1011101000],
  ["NOP", 0, 0xbf00], ["STM", 11, 0b11000], ["LDM", 11, 0b11001],
  ["BEQ", 8, 0xd0], ["BNE", 8, 0xd1], ["BCS", 8, 0xd2], ["BCC", 8, 0xd3], ["BMI", 8, 0xd4], ["BPL", 8, 0xd5],
  ["BVS", 8, 0xd6], ["BVC", 8, 0xd7], ["BHI", 8, 0xd8], ["BLS", 8, 0xd9], ["BGE", 8, 0xda], ["BLT", 8, 0xdb],
  ["BGT", 8, 0xdc], ["BLE", 8, 0xdd], ["B", 11, 0b11100], ["BL", 11, 0b11110],
];

/** Instruction of every halfword: index in the list from 1 on, or 0 if rp2040js executes it. */
export const FORM_OF = new Uint8Array(65536);
FORMS.forEach(([, shift, bits], k) => FORM_OF.fill(k + 1, bits << shift, (bits + 1) << shift));
